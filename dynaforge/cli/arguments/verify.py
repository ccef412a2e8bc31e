"""The arguments of `dynaforge verify`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.datasets import add_dataset_arguments
from dynaforge.cli.arguments.shared import add_workers
from dynaforge.cli.command import Command


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_dataset_arguments(parser)
    parser.add_argument(
        "--replay", action="store_true", help="make every recorded attempt again and compare all that it records"
    )
    parser.add_argument(
        "--audit",
        action="store_true",
        help="look for teleports, edited velocities, broken limits; with --replay for deep overlaps too; and list how "
        "hard each demonstration presses",
    )
    parser.add_argument(
        "--pictures",
        action="store_true",
        help="render again what lies in observations/ and compare it, bit for bit",
    )
    add_workers(parser)


COMMAND = Command(
    text="check a folder of demonstrations: bytes, values, outcomes; --replay simulates them again",
    examples=("verify data/can", "verify data/can --replay --audit"),
    add=add,
)
