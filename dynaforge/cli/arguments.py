"""The arguments of every command, checked before anything heavy is imported and before anything is made.

`check_...` looks at options together. See `commands.py`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dynaforge.cli.task_arguments import add_task_argument, chosen_task
from dynaforge.demos import DemonstrationDataset
from dynaforge.options.values import (
    MOST,
    SEED,
    Choice,
    Distinct,
    Existing,
    Number,
    Text,
    Whole,
    Written,
    add_workers,
    minutes,
    one_of,
    shard,
)
from dynaforge.sim.checks import shown
from dynaforge.tasks import STREAMS
from dynaforge.training.settings import arms, known_algorithms
from dynaforge.training.varied import check_varied

GENERATORS = ("planner_only", "residual", "exploring", "oracle")
COLLECTING = ("residual", "planner_only")  # the oracle knows the outcome beforehand, exploring is for training
USED_BY = {"policy": ("residual", "exploring"), "oracle_tries": ("oracle",), "sigma": ("exploring",)}
LEAST_BUDGET = 0.5  # minutes
SHIPPED = "policy file, for the generator residual; default: the shipped one"


def _add_stream(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument(
        "--stream", **one_of("stream", STREAMS), default=default,
        help="choose on val, report on test",
    )  # fmt: skip


def forge(parser: argparse.ArgumentParser) -> None:
    """Add the options of `forge`."""
    add_task_argument(parser, "--task")
    parser.add_argument(
        "--budget", type=minutes, default="13m", help="wall time for everything: 90s, 10m, 1.5h, or minutes"
    )
    parser.add_argument("--updates", type=Whole(), help="stop training after so many updates, even if time is left")
    parser.add_argument("--demos", type=Whole(), default=50, help="successful demonstrations to collect")
    parser.add_argument("--attempts", type=Whole(1, 10**5), default=100, help="fresh conditions of each measurement")
    parser.add_argument("--seed", type=SEED, default=0, help="training seed")
    parser.add_argument(
        "--algo", **one_of("algorithm", known_algorithms()), default="frontier_grpo",
        help="which file of zoo_configs to train with",
    )  # fmt: skip
    frames = ("target", "world")
    parser.add_argument("--residual-frame", **one_of("frame", frames), help="instead of the task's own")
    add_workers(parser)
    parser.add_argument(
        "--out", type=Written("folder", holding="forge.json"),
        help="folder, new or of this same command, which then goes on; by default runs/TASK-N",
    )  # fmt: skip


def check_forge(options: argparse.Namespace) -> None:
    """Refuse a budget in which nothing can be measured."""
    if options.budget < LEAST_BUDGET:
        raise ValueError(f"--budget is {60 * options.budget:g} s; it must be at least {60 * LEAST_BUDGET:g} s.")


def describe(parser: argparse.ArgumentParser) -> None:
    """Add the options of `describe`."""
    add_task_argument(parser, "task")
    parser.add_argument(
        "--out", type=Written("folder"),
        help="folder for the page and a picture of the skill; with all, a contact sheet too",
    )  # fmt: skip


def evaluate(parser: argparse.ArgumentParser) -> None:
    """Add the options of `evaluate`."""
    add_task_argument(parser, "--task", several=True)
    parser.add_argument(
        "--generator", nargs="+", type=Choice("generator", GENERATORS), action=Distinct, metavar="NAME",
        help=f"of {', '.join(GENERATORS)} (default planner_only, without --learner)",
    )  # fmt: skip
    parser.add_argument("--policy", type=Existing("file"), help=SHIPPED)
    parser.add_argument(
        "--learner", type=Text("module:function or file.py:function", r".+:[A-Za-z_][A-Za-z0-9_]*"),
        metavar="MODULE:FUNCTION",
        help="a policy learned from an export, as code that is run: FUNCTION(task) returns what maps an observation of "
        "the export to a row of its actions; or FILE.py:FUNCTION",
    )  # fmt: skip
    parser.add_argument(
        "--observations", type=Existing("folder", holding="settings.json", otherwise="holds no observations"),
        help="folder of `dynaforge render` whose cameras the learner was trained with",
    )  # fmt: skip
    _add_stream(parser, "val")
    parser.add_argument("--seeds", type=Whole(), default=3, help="blocks of conditions")
    parser.add_argument("--attempts", type=Whole(), default=100, help="conditions a block")
    parser.add_argument("--strata", action="store_true", help="spread each block evenly over 8 difficulty bins")
    parser.add_argument("--oracle-tries", type=Whole(), help="constant residuals a condition, for oracle (default 64)")
    parser.add_argument("--sigma", type=Number(0.0, 100.0), help="noise, for the generator exploring (default 0.25)")
    add_workers(parser)
    parser.add_argument(
        "--out", type=Written("file"),
        help="JSON file, conditions and outcomes included; by default runs/evaluate/GENERATORS-STREAM.json",
    )  # fmt: skip


def collect(parser: argparse.ArgumentParser) -> None:
    """Add the options of `collect`."""
    add_task_argument(parser, "--task")
    parser.add_argument("--demos", type=Whole(), help="stop after so many successes (default 50, without --attempts)")
    parser.add_argument("--attempts", type=Whole(), help="stop after so many attempts, successful or not")
    parser.add_argument(
        "--give-up-after", type=Whole(0), metavar="N",
        help="end, with the reasons, after N attempts in a row without a success; 0: never (default, with --demos: "
        "20 for each demonstration, at least 50)",
    )  # fmt: skip
    parser.add_argument("--generator", **one_of("generator", COLLECTING), default="residual", help="what attempts")
    parser.add_argument("--policy", type=Existing("file"), help=SHIPPED)
    parser.add_argument("--seed", type=SEED, default=0, help="block of the condition stream: another, other conditions")
    parser.add_argument(
        "--shard", type=shard, default=(0, 1), metavar="I/N",
        help="every Nth condition, the I-th first; --demos and --attempts are then those of the shard (default: all)",
    )  # fmt: skip
    parser.add_argument("--keep-failures", action="store_true", help="keep the recordings of failures too")
    add_workers(parser, "processes, or actors of the engine ray")
    parser.set_defaults(workers=None)  # each engine knows its cores
    engines = ("local", "ray")
    parser.add_argument(
        "--engine", **one_of("engine", engines), default="local",
        help="this machine's cores, or a running Ray cluster's",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Written("folder", holding="dataset.json"), help="new, or of an earlier run; by default data/TASK"
    )


def check_evaluate(options: argparse.Namespace) -> None:
    """Settle what is measured, and refuse what nothing measured would use."""
    if options.observations and not options.learner:
        raise ValueError("--observations is for --learner; no generator looks at pictures.")
    if options.generator is None:
        options.generator = [] if options.learner else ["planner_only"]
    check_generators(options)
    if options.learner:
        options.generator.append("learner")


def check_generators(options: argparse.Namespace) -> None:
    """Refuse what no generator would use."""
    given = [options.generator] if isinstance(options.generator, str) else options.generator
    for name, users in USED_BY.items():
        value = getattr(options, name, None)
        if value is not None and not set(users) & set(given):
            flag = f"--{name.replace('_', '-')} {value}"
            raise ValueError(
                f"{flag} is for the generator {' or '.join(users)}; --generator is {' '.join(given) or 'not given'}."
            )


def check_collect(options: argparse.Namespace) -> None:
    """Refuse what no generator would use, and a folder of another task."""
    check_generators(options)
    task, out = chosen_task(options).name, options.out or collecting_folder(options)
    if (out / "dataset.json").is_file() and (held := DemonstrationDataset(out).task) != task:
        raise ValueError(f"--out {out} holds demonstrations of {held!r}, not of {task!r}. Choose another folder.")


def collecting_folder(options: argparse.Namespace) -> Path:
    """Return where demonstrations are collected by default."""
    return Path("data") / chosen_task(options).name


def compare(parser: argparse.ArgumentParser) -> None:
    """Add the options of `compare`."""
    add_task_argument(parser, "--task", several=True)
    known = arms()
    parser.add_argument(
        "--algos", nargs="+", type=Choice("algorithm", known), action=Distinct, metavar="NAME",
        default=["ppo", "grpo", "frontier_grpo"], help=f"of {', '.join(known)}",
    )  # fmt: skip
    parser.add_argument("--train-seeds", type=Whole(1, 1000), default=3, help="training seeds 0, 1, ... of each")
    parser.add_argument(
        "--steps", type=Number(1, MOST), default=1e5, help="environment steps of a run, about 50 updates"
    )
    _add_stream(parser, "test")
    parser.add_argument(
        "--seeds", type=Whole(1, 1000), default=3, help="blocks of conditions that measure a finished policy"
    )
    parser.add_argument("--attempts", type=Whole(1, 10**5), default=100, help="conditions a block")
    parser.add_argument(
        "--vary", nargs="+", type=Text("a setting or a value, without '/'", r"[^/\x00-\x1f]+"),
        metavar=("SETTING", "VALUE"), help="an arm for each value, e.g. learning_rate 5e-4 1e-3",
    )  # fmt: skip
    add_workers(parser, "runs at a time, one core each")
    parser.add_argument("--budget", type=minutes, help="stop after so long (90s, 10m, 8h); the same command goes on")
    parser.add_argument(
        "--out", type=Written("folder"), default="runs/compare", help="folder of the runs and the report"
    )
    parser.add_argument("--report-only", action="store_true", help="start nothing, report what is stored")


def check_compare(options: argparse.Namespace) -> None:
    """Refuse values that make no arms, a folder of other things, and a report of nothing."""
    setting, *values = options.vary or ("none", "1")
    if not setting.isidentifier():
        raise ValueError(f"--vary {shown(setting)} is no setting; write --vary learning_rate 5e-4 1e-3, say.")
    if not values:
        raise ValueError(f"--vary {setting} names no values; write --vary {setting} VALUE [VALUE ...].")
    if len(set(values)) < len(values):
        raise ValueError(f"--vary {setting} names a value twice: {' '.join(values)}.")
    check_varied(setting, values)
    out = options.out
    if options.report_only and not any(out.glob("*/planner_only/exam.json")) and not any(out.glob("*/*/*/exam.json")):
        raise ValueError(f"--report-only finds nothing finished in {out}; leave it out to start the runs.")
    there = [path.name for path in out.iterdir() if path.name[0] != "."] if out.is_dir() else []
    if there and not any(out.glob("*/planner_only")) and not any(out.glob("*/*/seed-*")):
        raise ValueError(f"--out {out} holds other data ({there[0]}). Choose a new or empty folder.")


def bench(parser: argparse.ArgumentParser) -> None:
    """Add the options of `bench`."""
    from dynaforge.cli.bench import LONG, MEASUREMENTS

    add_task_argument(parser, "--task", several=True)
    listed = ", ".join(f"{name} (if named, minutes)" if name in LONG else name for name in MEASUREMENTS)
    parser.add_argument(
        "--only", nargs="+", type=Choice("figure", MEASUREMENTS), action=Distinct, metavar="NAME",
        help=f"some of {listed}",
    )  # fmt: skip
    parser.add_argument("--rounds", type=Whole(1, 1000), default=5, help="interleaved rounds of each measurement")
    parser.add_argument(
        "--out", type=Written("file"), help="write the figures and the rounds behind them here, e.g. results/bench.json"
    )
