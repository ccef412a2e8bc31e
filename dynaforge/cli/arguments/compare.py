"""The arguments of `dynaforge compare`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.shared import add_engine, add_stream
from dynaforge.cli.arguments.tasks import add_task_argument
from dynaforge.cli.command import Command
from dynaforge.options.numbers import LARGEST_COUNT, Number, WholeNumber, minutes
from dynaforge.options.parser import Distinct
from dynaforge.options.paths import OutputPath
from dynaforge.options.words import Choice, Text
from dynaforge.sim.checks import quoted
from dynaforge.training.settings import variants
from dynaforge.training.varied import check_varied


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_task_argument(parser, "--task", several=True, setting=True)
    known = variants()
    parser.add_argument(
        "--algos",
        nargs="+",
        type=Choice("algorithm", known),
        action=Distinct,
        metavar="NAME",
        default=["ppo", "grpo", "frontier_grpo"],
        help=f"of {', '.join(known)}",
    )
    parser.add_argument("--train-seeds", type=WholeNumber(1, 1000), default=3, help="training seeds 0, 1, ... of each")
    parser.add_argument(
        "--steps", type=Number(1, LARGEST_COUNT), default=1e5, help="environment steps of a run, about 50 updates"
    )
    add_stream(parser, "test")
    parser.add_argument(
        "--seeds", type=WholeNumber(1, 1000), default=3, help="blocks of conditions that measure a finished policy"
    )
    parser.add_argument("--attempts", type=WholeNumber(1, 10**5), default=100, help="conditions per block")
    parser.add_argument(
        "--vary",
        nargs="+",
        type=Text("a setting or a value, without '/'", r"[^/\x00-\x1f]+"),
        metavar=("SETTING", "VALUE"),
        help="a variant for each value, e.g. learning_rate 5e-4 1e-3",
    )
    add_engine(parser, "runs at a time, one core each")
    parser.add_argument("--budget", type=minutes, help="stop after so long (90s, 10m, 8h); the same command resumes")
    parser.add_argument(
        "--out", type=OutputPath("folder"), default="runs/compare", help="folder of the runs and the report"
    )
    parser.add_argument("--report-only", action="store_true", help="start nothing, report what is stored")


def check(options: argparse.Namespace) -> None:
    """Refuse values that make no variants, a folder with other contents, and a report of nothing."""
    setting, *values = options.vary or ("none", "1")
    if not setting.isidentifier():
        raise ValueError(f"--vary {quoted(setting)} is no setting; write --vary learning_rate 5e-4 1e-3, say.")
    if not values:
        raise ValueError(f"--vary {setting} names no values; write --vary {setting} VALUE [VALUE ...].")
    if len(set(values)) < len(values):
        raise ValueError(f"--vary {setting} names a value twice: {' '.join(values)}.")
    check_varied(setting, values)
    out = options.out
    finished = ("*/planner_only/exam.json", "*/*/*/exam.json", "*/runs.json")
    if options.report_only and not any(any(out.glob(name)) for name in finished):
        raise ValueError(f"--report-only finds nothing finished in {out}; leave it out to start the runs.")
    existing = [path.name for path in out.iterdir() if path.name[0] != "."] if out.is_dir() else []
    if existing and not any(any(out.glob(name)) for name in ("*/planner_only", "*/*/seed-*", "*/runs.json")):
        raise ValueError(f"--out {out} holds other data ({existing[0]}). Choose a new or empty folder.")


COMMAND = Command(
    text="train several algorithms on the same tasks and seeds, measure and report; resumes",
    examples=(
        "compare --task can --algos grpo frontier_grpo",
        "compare --algos grpo --vary learning_rate 5e-4 1e-3",
        "compare --task all --engine ray --budget 8h",
    ),
    add=add,
    check=check,
)
