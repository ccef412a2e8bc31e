"""The arguments of `dynaforge bench`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.tasks import add_task_argument
from dynaforge.cli.command import Command
from dynaforge.options.numbers import WholeNumber
from dynaforge.options.parser import Distinct
from dynaforge.options.paths import OutputPath
from dynaforge.options.words import Choice


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    from dynaforge.benchmarks.suite import LONG, MEASUREMENTS

    add_task_argument(parser, "--task", several=True)
    listed = ", ".join(f"{name} (if named, minutes)" if name in LONG else name for name in MEASUREMENTS)
    parser.add_argument(
        "--only",
        nargs="+",
        type=Choice("figure", MEASUREMENTS),
        action=Distinct,
        metavar="NAME",
        help=f"some of {listed}",
    )
    parser.add_argument("--rounds", type=WholeNumber(1, 1000), default=5, help="interleaved rounds of each measurement")
    parser.add_argument(
        "--out",
        type=OutputPath("file"),
        help="write the figures and the rounds behind them here, e.g. results/bench.json",
    )


COMMAND = Command(
    text="the project's figures: speed, determinism, limits, forces",
    examples=("bench", "bench --only reset control-steps --rounds 9 --out results/bench.json"),
    add=add,
)
