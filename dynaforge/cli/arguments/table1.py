"""The arguments of `dynaforge table1`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.evaluate import NAMED
from dynaforge.cli.arguments.shared import add_engine, add_stream
from dynaforge.cli.arguments.tasks import add_task_argument
from dynaforge.cli.command import Command
from dynaforge.generators.names import GRPO
from dynaforge.options.numbers import WholeNumber
from dynaforge.options.parser import Distinct
from dynaforge.options.paths import ExistingPath, OutputPath
from dynaforge.options.words import Choice

KNOWN = (*NAMED, GRPO)
DEFAULT = ("state_machine", "dmp", "planner_only", "prediction", GRPO, "residual", "replay")


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_task_argument(parser, "--task", several=True, default="all", setting=True)
    rows = [name for name in DEFAULT if name in KNOWN]
    parser.add_argument(
        "--generators",
        nargs="+",
        type=Choice("generator", KNOWN),
        action=Distinct,
        metavar="NAME",
        help=f"of {', '.join(KNOWN)} (default {' '.join(rows)}; grpo only with --grpo-policies)",
    )
    parser.add_argument(
        "--policies",
        type=ExistingPath("folder"),
        metavar="DIR",
        help="folder of residual policies, DIR/TASK/policy.safetensors; default: the shipped ones",
    )
    parser.add_argument(
        "--grpo-policies",
        type=ExistingPath("folder"),
        metavar="DIR",
        help="such a folder of policies by vanilla GRPO, for the row grpo; or one of `dynaforge compare`, whose "
        "training seed 0 is taken",
    )
    add_stream(parser, "test")
    parser.add_argument("--seeds", type=WholeNumber(1, 1000), default=3, help="blocks of conditions")
    parser.add_argument("--attempts", type=WholeNumber(1, 10**5), default=100, help="conditions of each block")
    parser.add_argument(
        "--sequential",
        action="store_true",
        help="compare with the residual only until an anytime-valid test at level 5 %% decides; by default every "
        "condition is attempted",
    )
    add_engine(parser)
    parser.add_argument(
        "--out", type=OutputPath("folder"), default="runs/table1", help="folder of the attempts and the tables"
    )
    parser.add_argument("--report-only", action="store_true", help="attempt nothing, report what is stored")


def check(options: argparse.Namespace) -> None:
    """Complete the list of generators; refuse policies that nothing uses, other data, and a report of nothing."""
    rows, out = options.generators, options.out
    if rows is None:
        rows = [name for name in DEFAULT if name in KNOWN and (name != GRPO or options.grpo_policies)]
        if options.report_only:
            rows = [name for name in DEFAULT if any(out.glob(f"*/{name}.json"))] or rows
    options.generators = rows
    if GRPO in rows and not (options.grpo_policies or options.report_only):
        raise ValueError("--generators grpo needs --grpo-policies DIR, the policies that vanilla GRPO has trained.")
    for name, row in (("--policies", "residual"), ("--grpo-policies", GRPO)):
        if getattr(options, name[2:].replace("-", "_")) and row not in rows:
            raise ValueError(f"{name} is for the row {row}; --generators is {' '.join(rows)}.")
    measured = any(out.glob("*/*.json"))
    if options.report_only and not measured:
        raise ValueError(f"--report-only finds nothing measured in {out}; leave it out to measure.")
    others = sorted(path.name for path in out.iterdir() if path.name[0] != ".") if out.is_dir() else []
    if others and not measured and "refused.json" not in others:
        raise ValueError(f"--out {out} holds other data ({others[0]}). Choose a new or empty folder.")


COMMAND = Command(
    text="the paper's first table: every generator on every task, on the same conditions; resumes",
    examples=(
        "table1",
        "table1 --task can peach --generators planner_only residual --attempts 50",
        "table1 --task all --engine ray",
        "table1 --sequential",
    ),
    add=add,
    check=check,
)
