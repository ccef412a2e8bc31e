"""The arguments of `dynaforge report`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.tasks import add_task_argument
from dynaforge.cli.command import Command
from dynaforge.options.numbers import WholeNumber
from dynaforge.options.paths import ExistingPath, OutputPath
from dynaforge.options.words import one_of

REPORTS = ("motivation",)


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "report",
        **one_of("report", REPORTS),
        help="motivation: the planner only, a replay and the residual on one condition, side by side, with the contact "
        "force on the robot: the first condition of val that the planner fails and the residual solves",
    )
    add_task_argument(parser, "--task", default="peach", setting=True)
    parser.add_argument("--policy", type=ExistingPath("file"), help="policy of the residual; default: the shipped one")
    parser.add_argument(
        "--conditions", type=WholeNumber(1, 10**5), default=100, help="conditions of val to look at, until one is such"
    )
    parser.add_argument("--frames", type=WholeNumber(2, 20), default=7, help="frames in a row of the film strip")
    parser.add_argument("--out", type=OutputPath("folder"), default="runs/motivation", help="folder of film and strip")


COMMAND = Command(
    text="pictures of what the figures mean: generators side by side, film and film strip with contact forces",
    examples=(
        "report motivation",
        "report motivation --task can --out results/motivation",
        "report motivation --task toycar --policy runs/toycar-1/policy.safetensors --frames 5",
    ),
    add=add,
)
