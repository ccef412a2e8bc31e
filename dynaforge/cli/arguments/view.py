"""The arguments of `dynaforge view`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.datasets import OBSERVATIONS, add_dataset_arguments
from dynaforge.cli.arguments.shared import add_observations, add_workers
from dynaforge.cli.command import Command
from dynaforge.options.numbers import WholeNumber
from dynaforge.options.paths import OutputPath


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_dataset_arguments(parser)
    parser.add_argument(
        "--limit", type=WholeNumber(), default=40, help="recordings with clip and plots, spread over the difficulties"
    )
    parser.add_argument("--no-clips", action="store_true", help="plots only, which is far quicker")
    add_observations(parser, OBSERVATIONS)
    add_workers(parser)
    parser.add_argument(
        "--viser", action="store_true", help="also a page with the scene in three dimensions, 1 MB per recording"
    )
    parser.add_argument(
        "--rerun", action="store_true", help="also a .rrd file for Rerun's viewer, 0.5 MB per recording"
    )
    parser.add_argument("--out", type=OutputPath("file"), help="HTML file (default: view.html in the folder)")


def check(options: argparse.Namespace) -> None:
    """Refuse pictures that would not be shown."""
    if options.no_clips and options.observations:
        raise ValueError("--no-clips leaves out what --observations would show; give one of them.")


COMMAND = Command(
    text="one HTML page to look through a folder of demonstrations: clips, plots, filters",
    examples=("view data/can", "view data/can --no-clips --limit 200 --out can.html"),
    add=add,
    check=check,
    default_out=lambda options: options.folder / "view.html",
)
