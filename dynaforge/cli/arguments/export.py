"""The arguments of `dynaforge export`."""

from __future__ import annotations

import argparse
from pathlib import Path

from dynaforge.cli.arguments.datasets import OBSERVATIONS, add_dataset_arguments
from dynaforge.cli.arguments.shared import add_observations
from dynaforge.cli.command import Command
from dynaforge.options.numbers import WholeNumber
from dynaforge.options.paths import OutputPath
from dynaforge.options.words import Text, one_of


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_dataset_arguments(parser)
    _add_format(parser)
    _add_contents(parser)
    licence = Text("an SPDX identifier such as MIT or CC-BY-4.0", r"[A-Za-z0-9][A-Za-z0-9.+() -]*")
    parser.add_argument(
        "--replays",
        type=WholeNumber(0),
        default=10,
        metavar="N",
        help="successes whose actions are given to the task's env, to see them succeed again",
    )
    parser.add_argument("--license", type=licence, default="MIT", help="SPDX identifier for the card")
    parser.add_argument("--out", type=OutputPath("folder", new=True), help="new folder; by default FOLDER-FORMAT")


def _add_format(parser: argparse.ArgumentParser) -> None:
    from dynaforge.demos.exporters import FORMATS
    from dynaforge.tasks.action import ACTION_MODES, ROTATIONS

    parser.add_argument(
        "--format",
        required=True,
        **one_of("format", FORMATS),
        help="; ".join(f"{name}: {text}" for name, text in FORMATS.items()),
    )
    parser.add_argument(
        "--actions",
        default="ee",
        **one_of("action", ACTION_MODES),
        help="end-effector pose or joint positions, and width",
    )
    parser.add_argument(
        "--rotation",
        default="quat_wxyz",
        **one_of("rotation", ROTATIONS),
        help="of an end-effector pose: quaternion, two columns of its matrix, which never jump, or rotation vector",
    )
    parser.add_argument(
        "--no-elbow",
        action="store_true",
        help="end-effector actions without the third joint's angle; fast motions are then not met exactly",
    )


def _add_contents(parser: argparse.ArgumentParser) -> None:
    add_observations(parser, OBSERVATIONS)
    parser.add_argument("--no-observations", action="store_true", help="leave out what observations/ contains")
    parser.add_argument(
        "--depth",
        action="store_true",
        help="depth maps in a LeRobot dataset too, whose policies take them for pictures; the others have them anyway",
    )
    parser.add_argument(
        "--privileged",
        action="store_true",
        help="the truth about objects beside pictures and points too; without those it is there anyway",
    )
    parser.add_argument("--failures", action="store_true", help="failed recordings too (collect --keep-failures)")


def check(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other, and a format without what it needs."""
    observations = options.observations or options.folder / "observations"
    if options.format == "dp3-zarr" and (options.no_observations or not (observations / "settings.json").is_file()):
        raise ValueError(f"--format dp3-zarr needs point clouds: `dynaforge render {options.folder} --points 1024`.")
    if options.no_observations and options.observations:
        raise ValueError("--observations names what --no-observations leaves out; give one of the two.")
    if options.actions == "joint" and options.rotation != "quat_wxyz":
        raise ValueError(f"--rotation {options.rotation} belongs to --actions ee; joint positions have no rotation.")
    if options.actions == "joint" and options.no_elbow:
        raise ValueError("--no-elbow belongs to --actions ee; joint positions determine the elbow.")


def default_folder(options: argparse.Namespace) -> Path:
    """Return the folder beside that of the demonstrations, with the format in its name."""
    folder: Path = options.folder.resolve()
    return folder.with_name(f"{folder.name}-{options.format}")


COMMAND = Command(
    text="demonstrations as LeRobot, robomimic, DP3's zarr or Minari data, with a card",
    examples=(
        "export data/can --format lerobot",
        "export data/can --format robomimic --actions joint --out can-robomimic",
    ),
    add=add,
    check=check,
    default_out=default_folder,
)
