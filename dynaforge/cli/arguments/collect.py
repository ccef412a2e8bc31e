"""The arguments of `dynaforge collect`."""

from __future__ import annotations

import argparse
from pathlib import Path

from dynaforge.cli.arguments.generators import add_policy, add_replay, check_generators
from dynaforge.cli.arguments.shared import add_engine
from dynaforge.cli.arguments.tasks import add_task_argument, chosen_task
from dynaforge.cli.command import Command
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.provenance import check_setting
from dynaforge.generators.names import COLLECTING
from dynaforge.options.numbers import SEED, WholeNumber, shard
from dynaforge.options.paths import OutputPath
from dynaforge.options.words import one_of


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_task_argument(parser, "--task", setting=True)
    parser.add_argument(
        "--demos", type=WholeNumber(), help="stop after so many successes (default 50, without --attempts)"
    )
    parser.add_argument("--attempts", type=WholeNumber(), help="stop after so many attempts, successful or not")
    parser.add_argument(
        "--give-up-after",
        type=WholeNumber(0),
        metavar="N",
        help="end, with the reasons, after N attempts in a row without a success; 0: never (default, with --demos: "
        "20 for each demonstration, at least 50)",
    )
    parser.add_argument("--generator", **one_of("generator", COLLECTING), default="residual", help="what attempts")
    add_policy(parser)
    add_replay(parser)
    parser.add_argument("--seed", type=SEED, default=0, help="block of the condition stream: another, other conditions")
    parser.add_argument(
        "--shard",
        type=shard,
        default=(0, 1),
        metavar="I/N",
        help="every Nth condition, the I-th first; --demos and --attempts are then those of the shard (default: all)",
    )
    parser.add_argument("--keep-failures", action="store_true", help="keep the recordings of failures too")
    add_engine(parser)
    parser.add_argument(
        "--out",
        type=OutputPath("folder", containing="dataset.json"),
        help="a new folder, or that of an earlier run; by default data/TASK",
    )


def check(options: argparse.Namespace) -> None:
    """Refuse settings that the generator does not use, and a folder of another task or of another setting."""
    check_generators(options)
    task, out = chosen_task(options), options.out or default_folder(options)
    if not (out / "dataset.json").is_file():
        return
    dataset = DemonstrationDataset(out)
    if dataset.task != task.name:
        raise ValueError(
            f"--out {out} holds demonstrations of {dataset.task!r}, not of {task.name!r}. Choose another folder."
        )
    check_setting(f"--out {out}", dataset.sources().values(), task.setting)


def default_folder(options: argparse.Namespace) -> Path:
    """Return the default folder for demonstrations."""
    return Path("data") / chosen_task(options).name


COMMAND = Command(
    text="demonstrations into a folder, on all cores; resumes",
    examples=(
        "collect --task can --generator planner_only --demos 20",
        "collect --task peach --policy runs/peach-1/policy.safetensors --shard 0/4",
    ),
    add=add,
    check=check,
    default_out=default_folder,
)
