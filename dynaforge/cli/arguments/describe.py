"""The arguments of `dynaforge list` and `dynaforge describe`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.tasks import add_task_argument
from dynaforge.cli.command import Command
from dynaforge.options.paths import OutputPath


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `describe`; `list` has none."""
    add_task_argument(parser, "task")
    parser.add_argument(
        "--out",
        type=OutputPath("folder"),
        help="folder for the page and a picture of the skill; with all, a contact sheet too",
    )


LIST = Command(text="the tasks", examples=("list",), module="describe")

COMMAND = Command(
    text="one task: motion, randomisation, phases, success",
    examples=("describe can", "describe all --out docs/tasks"),
    add=add,
)
