"""The arguments of `dynaforge forge`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.shared import add_workers
from dynaforge.cli.arguments.tasks import add_task_argument
from dynaforge.cli.command import Command
from dynaforge.options.numbers import SEED, WholeNumber, minutes
from dynaforge.options.paths import OutputPath
from dynaforge.options.words import one_of
from dynaforge.tasks import FRAMES
from dynaforge.training.forge_folder import default_folder
from dynaforge.training.settings import known_algorithms

LEAST_BUDGET = 0.5  # minutes


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_task_argument(parser, "--task", setting=True)
    parser.add_argument(
        "--budget", type=minutes, default="13m", help="wall time for everything: 90s, 10m, 1.5h, or minutes"
    )
    parser.add_argument(
        "--updates", type=WholeNumber(), help="stop training after so many updates, even if time is left"
    )
    parser.add_argument("--demos", type=WholeNumber(), default=50, help="successful demonstrations to collect")
    parser.add_argument(
        "--attempts", type=WholeNumber(1, 10**5), default=100, help="fresh conditions of each measurement"
    )
    parser.add_argument("--seed", type=SEED, default=0, help="training seed")
    parser.add_argument(
        "--algo",
        **one_of("algorithm", known_algorithms()),
        default="frontier_grpo",
        help="which file of zoo_configs to train with",
    )
    parser.add_argument("--residual-frame", **one_of("frame", FRAMES), help="instead of the task's own")
    add_workers(parser)
    parser.add_argument(
        "--out",
        type=OutputPath("folder", containing="forge.json"),
        help="a new folder, or that of an earlier run of this command, which it then resumes; by default runs/TASK-N",
    )


def check(options: argparse.Namespace) -> None:
    """Refuse a budget too short to measure anything."""
    if options.budget < LEAST_BUDGET:
        raise ValueError(f"--budget is {60 * options.budget:g} s; it must be at least {60 * LEAST_BUDGET:g} s.")


COMMAND = Command(
    text="from nothing to demonstrations: measure the planner, train, measure again, collect, report",
    examples=("forge --task can", "forge --task peach --budget 30m --demos 200 --out runs/peach"),
    add=add,
    check=check,
    default_out=default_folder,
)
