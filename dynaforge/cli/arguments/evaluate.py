"""The arguments of `dynaforge evaluate`."""

from __future__ import annotations

import argparse
from pathlib import Path

from dynaforge.cli.arguments.generators import add_policy, add_replay, check_generators
from dynaforge.cli.arguments.setting import chosen_parts
from dynaforge.cli.arguments.shared import add_engine, add_observations, add_stream
from dynaforge.cli.arguments.tasks import add_task_argument
from dynaforge.cli.command import Command
from dynaforge.generators.names import GENERATORS
from dynaforge.options.numbers import Number, WholeNumber
from dynaforge.options.parser import Distinct
from dynaforge.options.paths import OutputPath
from dynaforge.options.words import Choice, Text

NAMED = tuple(name for name in GENERATORS if name != "learner")  # it is chosen by --learner instead


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_task_argument(parser, "--task", several=True, setting=True)
    parser.add_argument(
        "--generator",
        nargs="+",
        type=Choice("generator", NAMED),
        action=Distinct,
        metavar="NAME",
        help=f"of {', '.join(NAMED)} (default planner_only, without --learner)",
    )
    add_policy(parser)
    add_replay(parser)
    parser.add_argument(
        "--learner",
        type=Text("module:function or file.py:function", r".+:[A-Za-z_][A-Za-z0-9_]*"),
        metavar="MODULE:FUNCTION",
        help="a policy learned from an export, as code that is run: FUNCTION(task) returns what maps an observation of "
        "the export to a row of its actions; or FILE.py:FUNCTION",
    )
    add_observations(parser, "folder of `dynaforge render` whose cameras the learner was trained with")
    add_stream(parser, "val")
    parser.add_argument("--seeds", type=WholeNumber(), default=3, help="blocks of conditions")
    parser.add_argument("--attempts", type=WholeNumber(), default=100, help="conditions per block")
    parser.add_argument("--strata", action="store_true", help="spread each block evenly over 8 difficulty bins")
    parser.add_argument(
        "--sequential",
        action="store_true",
        help="compare a generator with the first one only until an anytime-valid test at level 5 %% decides",
    )
    parser.add_argument(
        "--oracle-tries",
        type=WholeNumber(),
        help="random residuals per condition for oracle: constant, redrawn for each phase, with feedback (default 64)",
    )
    parser.add_argument("--sigma", type=Number(0.0, 100.0), help="noise, for the generator exploring (default 0.25)")
    add_engine(parser)
    parser.add_argument(
        "--out",
        type=OutputPath("file"),
        help="JSON file, conditions and outcomes included; by default runs/evaluate/GENERATORS-STREAM.json, or "
        "GENERATORS-STREAM-SETTING.json if a setting is chosen",
    )


def check(options: argparse.Namespace) -> None:
    """Complete the list of generators, and refuse settings that none of them uses."""
    if options.observations and not options.learner:
        raise ValueError("--observations is for --learner; no generator looks at pictures.")
    if options.generator is None:
        options.generator = [] if options.learner else ["planner_only"]
    check_generators(options)
    if options.learner:
        options.generator.append("learner")


def default_file(options: argparse.Namespace) -> Path:
    """Return the default file: its name tells the generators, the stream and what was chosen of the setting."""
    setting = [str(getattr(options, name)).replace(":", "-") for name in chosen_parts(options)]
    return Path("runs/evaluate") / f"{'-'.join(['+'.join(options.generator), options.stream, *setting])}.json"


COMMAND = Command(
    text="demonstration generation rate of a generator on stored condition streams",
    examples=(
        "evaluate --task can --generator planner_only residual --policy runs/can-1/policy.safetensors",
        "evaluate --task all --stream test --attempts 200",
        "evaluate --task can --learner my_policy.py:load",
    ),
    add=add,
    check=check,
    default_out=default_file,
)
