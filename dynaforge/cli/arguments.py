"""The arguments of every command, checked before anything heavy is imported and before anything is made.

`check_...` looks at options together. See `commands.py`.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from dynaforge.cli.options import (
    MOST,
    MOST_WORKERS,
    NAME,
    SEEDS,
    Choice,
    Distinct,
    Existing,
    Number,
    Text,
    Whole,
    Written,
    minutes,
    one_of,
    shard,
)
from dynaforge.cli.settings import arms, known_algorithms
from dynaforge.cli.task_arguments import add_task_argument
from dynaforge.tasks import STREAMS

GENERATORS = ("planner_only", "residual", "exploring", "oracle")
COLLECTING = ("residual", "planner_only")  # the oracle knows the outcome beforehand, exploring is for training
SHIPPED = "policy file, for the generator residual; default: the shipped one"


def _add_workers(parser: argparse.ArgumentParser, what: str = "processes") -> None:
    parser.add_argument(
        "--workers", type=Whole(1, MOST_WORKERS), default=os.cpu_count() or 1, help=f"{what}; by default one a core"
    )


def _add_observations(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--observations", type=Existing("folder", holding="settings.json", otherwise="holds no observations"),
        help="folder of `dynaforge render`; by default observations/ if there",
    )  # fmt: skip


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
    parser.add_argument("--attempts", type=Whole(), default=100, help="fresh conditions of each measurement")
    parser.add_argument("--seed", type=Whole(0, SEEDS - 1), default=0, help="training seed")
    parser.add_argument(
        "--algo",
        **one_of("algorithm", known_algorithms()),
        default="frontier_grpo",
        help="which file of zoo_configs to train with",
    )
    frames = ("target", "world")
    parser.add_argument("--residual-frame", **one_of("frame", frames), help="instead of the task's own")
    _add_workers(parser)
    parser.add_argument("--out", type=Written("folder"), help="new or empty folder; by default a new runs/TASK-N")


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
        "--generator", nargs="+", type=Choice("generator", GENERATORS), action=Distinct, default=["planner_only"],
        metavar="NAME", help=f"of {', '.join(GENERATORS)}",
    )  # fmt: skip
    parser.add_argument("--policy", type=Existing("file"), help=SHIPPED)
    _add_stream(parser, "val")
    parser.add_argument("--seeds", type=Whole(), default=3, help="blocks of conditions")
    parser.add_argument("--attempts", type=Whole(), default=100, help="conditions a block")
    parser.add_argument("--strata", action="store_true", help="spread each block evenly over 8 difficulty bins")
    parser.add_argument("--oracle-tries", type=Whole(), help="constant residuals a condition, for oracle (default 64)")
    parser.add_argument("--sigma", type=Number(0.0, 100.0), help="noise, for the generator exploring (default 0.25)")
    _add_workers(parser)
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
    parser.add_argument(
        "--generator",
        **one_of("generator", COLLECTING),
        default="residual",
        help="what attempts",
    )
    parser.add_argument("--policy", type=Existing("file"), help=SHIPPED)
    parser.add_argument(
        "--seed", type=Whole(0, SEEDS - 1), default=0, help="block of the condition stream: another, other conditions"
    )
    parser.add_argument(
        "--shard", type=shard, default=(0, 1), metavar="I/N",
        help="every Nth condition, the I-th first; --demos and --attempts are then those of the shard (default: all)",
    )  # fmt: skip
    parser.add_argument("--keep-failures", action="store_true", help="keep the recordings of failures too")
    _add_workers(parser, "processes, or actors of the engine ray")
    parser.set_defaults(workers=None)  # each engine knows its cores
    engines = ("local", "ray")
    parser.add_argument(
        "--engine", **one_of("engine", engines), default="local",
        help="this machine's cores, or a running Ray cluster's",
    )  # fmt: skip
    parser.add_argument("--out", type=Written("folder"), help="new, or of an earlier run; by default data/TASK")


def check_generators(options: argparse.Namespace) -> None:
    """Refuse what no generator would use."""
    given = [options.generator] if isinstance(options.generator, str) else options.generator
    for name, users in (
        ("policy", ("residual", "exploring")),
        ("oracle_tries", ("oracle",)),
        ("sigma", ("exploring",)),
    ):
        value = getattr(options, name, None)
        if value is not None and not set(users) & set(given):
            flag = f"--{name.replace('_', '-')} {value}"
            raise ValueError(f"{flag} is for the generator {' or '.join(users)}; --generator is {' '.join(given)}.")


def on_dataset(parser: argparse.ArgumentParser) -> None:
    """Add the folder and, for tasks of one's own, their file."""
    held = Existing("folder", holding="dataset.json", otherwise="holds no demonstrations")
    parser.add_argument("folder", type=held, help="folder of `dynaforge collect`")
    parser.add_argument("--task-file", type=Existing("task file"), help="file of the task, where it is one of your own")


def render(parser: argparse.ArgumentParser) -> None:
    """Add the options of `render`."""
    on_dataset(parser)
    parser.add_argument(
        "--cameras", nargs="+", type=Text("the name of a camera", NAME), action=Distinct, metavar="NAME",
        default=["front", "wrist"], help="of front, side, wrist, or your own",
    )  # fmt: skip
    parser.add_argument(
        "--camera-file", type=Existing("file"),
        help="JSON list of cameras of your own: name, eye, look_at, up, in_hand, size, fov",
    )  # fmt: skip
    parser.add_argument("--size", nargs=2, type=Whole(1, 4096), metavar=("W", "H"), help="pixels (default 128 128)")
    parser.add_argument(
        "--points", type=Whole(0, 10**6), default=0, help="size of the point clouds, e.g. 1024; 0 for none"
    )
    parser.add_argument("--no-images", action="store_true", help="keep the point clouds only")
    parser.add_argument(
        "--workspace", nargs=6, type=Number(-1e6, 1e6), metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="box that the points are cropped to, metres; by default all that the tasks reach, above the table",
    )  # fmt: skip
    _add_workers(parser)
    parser.add_argument(
        "--out", type=Written("folder"), help="folder of the observations (default: observations/ in the dataset's)"
    )


def check_render(options: argparse.Namespace) -> None:
    """Refuse an empty workspace, and a rendering of nothing."""
    if options.workspace is not None:
        for axis, low, high in zip("XYZ", options.workspace[:3], options.workspace[3:], strict=True):
            if low >= high:
                raise ValueError(f"--workspace is empty: {axis}0 is {low:g}, {axis}1 must be more than that.")
    if options.no_images and not options.points:
        raise ValueError("--no-images leaves nothing to render: ask for --points, or leave it out.")


def view(parser: argparse.ArgumentParser) -> None:
    """Add the options of `view`."""
    on_dataset(parser)
    parser.add_argument(
        "--limit", type=Whole(), default=40, help="recordings with clip and plots, spread over the difficulties"
    )
    parser.add_argument("--no-clips", action="store_true", help="plots only, in a fiftieth of the time")
    _add_observations(parser)
    _add_workers(parser)
    parser.add_argument(
        "--viser", action="store_true", help="also a page with the scene in three dimensions, 1 MB a recording"
    )
    parser.add_argument("--rerun", action="store_true", help="also a .rrd file for Rerun's viewer, 0.5 MB a recording")
    parser.add_argument("--out", type=Written("file"), help="HTML file (default: view.html in the folder)")


def check_view(options: argparse.Namespace) -> None:
    """Refuse pictures that would not be shown."""
    if options.no_clips and options.observations:
        raise ValueError("--no-clips leaves out what --observations would show; give one of them.")


def export(parser: argparse.ArgumentParser) -> None:
    """Add the options of `export`."""
    from dynaforge.demos.exporters import FORMATS
    from dynaforge.tasks.action import ACTION_MODES, ROTATIONS

    on_dataset(parser)
    parser.add_argument(
        "--format", required=True, **one_of("format", FORMATS),
        help="; ".join(f"{name}: {text}" for name, text in FORMATS.items()),
    )  # fmt: skip
    parser.add_argument(
        "--actions", default="ee", **one_of("action", ACTION_MODES),
        help="end-effector pose or joint positions, and width",
    )  # fmt: skip
    parser.add_argument(
        "--rotation", default="quat_wxyz", **one_of("rotation", ROTATIONS),
        help="of an end-effector pose: quaternion, two columns of its matrix, which jump nowhere, or rotation vector",
    )  # fmt: skip
    parser.add_argument(
        "--no-elbow", action="store_true",
        help="end-effector actions without the third joint's angle; fast motions are then not met exactly",
    )  # fmt: skip
    _add_observations(parser)
    parser.add_argument("--no-observations", action="store_true", help="leave out what observations/ holds")
    parser.add_argument(
        "--depth", action="store_true",
        help="depth maps in a LeRobot dataset too, whose policies take them for pictures; the others hold them anyway",
    )  # fmt: skip
    parser.add_argument(
        "--privileged", action="store_true",
        help="the truth about objects beside pictures and points too; without those it is there anyway",
    )  # fmt: skip
    parser.add_argument("--failures", action="store_true", help="failed recordings too (collect --keep-failures)")
    licence = Text("an SPDX identifier such as MIT or CC-BY-4.0", r"[A-Za-z0-9][A-Za-z0-9.+() -]*")
    parser.add_argument("--license", type=licence, default="MIT", help="SPDX identifier for the card")
    parser.add_argument("--out", type=Written("folder"), help="new folder; by default FOLDER-FORMAT")


def check_export(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other."""
    if options.no_observations and options.observations:
        raise ValueError("--observations names what --no-observations leaves out; give one of the two.")
    if options.actions == "joint" and options.rotation != "quat_wxyz":
        raise ValueError(f"--rotation {options.rotation} belongs to --actions ee; joint positions have no rotation.")
    if options.actions == "joint" and options.no_elbow:
        raise ValueError("--no-elbow belongs to --actions ee; joint positions settle the elbow.")


def verify(parser: argparse.ArgumentParser) -> None:
    """Add the options of `verify`."""
    on_dataset(parser)
    parser.add_argument("--replay", action="store_true", help="simulate every recording again and compare all states")
    parser.add_argument(
        "--audit", action="store_true",
        help="look for teleports, edited velocities, broken limits; with --replay for deep overlaps too",
    )  # fmt: skip


def compare(parser: argparse.ArgumentParser) -> None:
    """Add the options of `compare`."""
    add_task_argument(parser, "--task", several=True)
    known = arms()
    parser.add_argument(
        "--algos", nargs="+", type=Choice("algorithm", known), action=Distinct, metavar="NAME",
        default=["ppo", "grpo", "frontier_grpo"], help=f"of {', '.join(known)}",
    )  # fmt: skip
    parser.add_argument("--train-seeds", type=Whole(), default=3, help="training seeds 0, 1, ... of each")
    parser.add_argument(
        "--steps", type=Number(1, MOST), default=1e5, help="environment steps of a run, about 50 updates"
    )
    _add_stream(parser, "test")
    parser.add_argument("--seeds", type=Whole(), default=3, help="blocks of conditions that measure a finished policy")
    parser.add_argument("--attempts", type=Whole(), default=100, help="conditions a block")
    parser.add_argument(
        "--vary", nargs="+", type=Text("a setting and its values", r"[ -~]+"), metavar=("SETTING", "VALUE"),
        help="an arm for each value, e.g. learning_rate 5e-4 1e-3",
    )  # fmt: skip
    _add_workers(parser, "runs at a time, one core each")
    parser.add_argument("--budget", type=minutes, help="stop after so long (90s, 10m, 8h); the same command goes on")
    parser.add_argument(
        "--out", type=Written("folder"), default=Path("runs/compare"), help="folder of the runs and the report"
    )
    parser.add_argument("--report-only", action="store_true", help="start nothing, report what is stored")


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
