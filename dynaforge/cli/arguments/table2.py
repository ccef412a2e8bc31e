"""The arguments of `dynaforge table2`."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.generators import add_policy, add_replay, check_generators
from dynaforge.cli.arguments.shared import add_engine, add_stream
from dynaforge.cli.arguments.tasks import add_task_argument
from dynaforge.cli.command import Command
from dynaforge.generators.names import COLLECTING, GRPO, SETTINGS
from dynaforge.options.numbers import WholeNumber
from dynaforge.options.parser import Distinct
from dynaforge.options.paths import ExistingPath, OutputPath
from dynaforge.options.words import Choice, Text

TASKS = ("can", "bottle", "toycar", "peach", "block")
"""The tasks of the paper's table, `dynaforge.evaluation.costs.PAPER_TASKS`, named where nothing heavy is imported."""

TRAINED = (*SETTINGS["policy"], GRPO)
"""What runs a trained policy, so that its training is part of its cost."""


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_task_argument(parser, "--task", several=True, setting=True)
    parser.set_defaults(task=list(TASKS))
    parser.add_argument(
        "--generator",
        nargs="+",
        type=Choice("generator", (*COLLECTING, GRPO)),
        action=Distinct,
        metavar="NAME",
        default=list(COLLECTING),
        help=f"of {', '.join(COLLECTING)} (default: these), and {GRPO} if --measured has it",
    )
    parser.add_argument(
        "--measured",
        nargs="+",
        type=ExistingPath("file"),
        action=Distinct,
        metavar="FILE",
        default=[],
        help="JSON files of `dynaforge evaluate`, or of pairs of `dynaforge table1`, with rates and processor times; "
        "what they lack is measured now",
    )
    parser.add_argument(
        "--training",
        type=ExistingPath("folder"),
        help="folder of the `dynaforge compare` or `dynaforge forge` that trained the policies, whose CPU-hours are "
        "part of the cost of the generator residual",
    )
    parser.add_argument(
        "--variant",
        type=Text("the name of a variant, without '/'", r"[^/\x00-\x1f]+"),
        help="which trainings of that folder; needed where it has several variants",
    )
    add_policy(parser)
    add_replay(parser)
    parser.add_argument("--demos", type=WholeNumber(), default=800, help="demonstrations per task")
    add_stream(parser, "test")
    parser.add_argument("--seeds", type=WholeNumber(1, 1000), default=3, help="blocks of conditions to measure on")
    parser.add_argument("--attempts", type=WholeNumber(1, 10**5), default=20, help="conditions per block")
    add_engine(parser)
    parser.add_argument(
        "--out",
        type=OutputPath("folder"),
        default="runs/table2",
        help="folder of the table and of what is measured",
    )


def check(options: argparse.Namespace) -> None:
    """Refuse settings that no generator uses, a policy for several tasks, and a policy of unknown cost."""
    check_generators(options)
    if (options.policy and len(options.task) > 1) or (options.task == ["all"] and options.policy):
        raise ValueError(f"--policy {options.policy} is for one task; name it with --task.")
    if options.variant and not options.training:
        raise ValueError(f"--variant {options.variant} is one of --training, which is not given.")
    trained = [name for name in options.generator if name in TRAINED]
    if trained and not options.training:
        raise ValueError(
            f"--training is missing: {' and '.join(trained)} needs a trained policy, whose CPU-hours are part of the "
            "cost. Name the folder of the `dynaforge compare` or `dynaforge forge` that trained it, or leave "
            f"{' and '.join(trained)} out of --generator."
        )


COMMAND = Command(
    text="what demonstrations cost: CPU-hours of preparation and collection, beside the paper's cost model; resumes",
    examples=(
        "table2 --generator planner_only --task can",
        "table2 --task can bottle --training results/choice --variant failures",
        "table2 --measured runs/evaluate/residual-test.json --training runs/compare --out results/table2",
    ),
    add=add,
    check=check,
)
