"""The arguments of `dynaforge render`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.datasets import add_dataset_arguments
from dynaforge.cli.arguments.shared import add_engine
from dynaforge.cli.command import Command
from dynaforge.options.numbers import Number, WholeNumber
from dynaforge.options.parser import Distinct
from dynaforge.options.paths import ExistingPath, OutputPath
from dynaforge.options.words import FILE_NAME_PART, Text


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_dataset_arguments(parser)
    parser.add_argument(
        "--cameras",
        nargs="+",
        type=Text("the name of a camera", FILE_NAME_PART),
        action=Distinct,
        metavar="NAME",
        default=["front", "wrist"],
        help="of front, side, wrist, or your own",
    )
    parser.add_argument(
        "--camera-file",
        type=ExistingPath("file"),
        help="JSON list of cameras of your own: name, eye, look_at, up, in_hand, size, fov",
    )
    parser.add_argument(
        "--size", nargs=2, type=WholeNumber(1, 4096), metavar=("W", "H"), help="pixels (default 128 128)"
    )
    parser.add_argument(
        "--points", type=WholeNumber(0, 10**6), default=0, help="size of the point clouds, e.g. 1024; 0 for none"
    )
    parser.add_argument("--no-images", action="store_true", help="keep the point clouds only")
    parser.add_argument(
        "--workspace",
        nargs=6,
        type=Number(-1e6, 1e6),
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="box that the points are cropped to, metres; by default all that the tasks reach, above the table",
    )
    add_engine(parser)
    parser.add_argument(
        "--out",
        type=OutputPath("folder", containing="settings.json"),
        help="folder of the observations (default: observations/ in the dataset's)",
    )


def check(options: argparse.Namespace) -> None:
    """Refuse an empty workspace, and a rendering of nothing."""
    if options.workspace is not None:
        for axis, low, high in zip("XYZ", options.workspace[:3], options.workspace[3:], strict=True):
            if low >= high:
                raise ValueError(f"--workspace is empty: {axis}0 is {low:g}, {axis}1 must be more than that.")
    if options.no_images and not options.points:
        raise ValueError("--no-images leaves nothing to render: ask for --points, or leave it out.")


COMMAND = Command(
    text="pictures and point clouds of collected episodes, in a second pass; resumes",
    examples=("render data/can", "render data/can --cameras front --size 84 84 --points 1024"),
    add=add,
    check=check,
    default_out=lambda options: options.folder / "observations",
)
