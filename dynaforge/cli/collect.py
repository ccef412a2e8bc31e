"""`dynaforge collect`: demonstrations into a folder; any interruption costs the attempts under way."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from tqdm import tqdm

from dynaforge.cli.evaluate import make_generator
from dynaforge.cli.task_arguments import add_task_argument, chosen_task
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.generators import Goal, Source, collect, run_attempts
from dynaforge.generators.ray_engine import run_attempts_on_ray

GENERATORS = ("residual", "planner_only")


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Add the options of `collect`."""
    add_task_argument(parser, "--task")
    parser.add_argument("--demos", type=int, help="stop after so many successes (default 50, without --attempts)")
    parser.add_argument("--attempts", type=int, help="stop after so many attempts, successful or not")
    parser.add_argument("--generator", default="residual", choices=GENERATORS, help="what attempts")
    parser.add_argument("--policy", type=Path, help="policy file for the generator residual; default: the shipped one")
    parser.add_argument("--seed", type=int, default=0, help="block of the condition stream: another, other conditions")
    parser.add_argument(
        "--shard",
        type=shard,
        default=(0, 1),
        metavar="I/N",
        help="every Nth condition, the I-th first; --demos and --attempts are then those of the shard",
    )
    parser.add_argument("--keep-failures", action="store_true", help="keep the recordings of failures too")
    parser.add_argument("--workers", type=int, help="processes or actors; all cores by default")
    parser.add_argument(
        "--engine", default="local", choices=("local", "ray"), help="this machine's cores, or a running Ray cluster's"
    )
    parser.add_argument("--out", type=Path, help="folder, new or of an earlier run; by default data/TASK")


def shard(text: str) -> tuple[int, int]:
    """Read "I/N", I from 0.

    Raises:
        argparse.ArgumentTypeError: Something else.
    """
    first, _, second = text.partition("/")
    if not (first.isdigit() and second.isdigit() and int(first) < int(second)):
        raise argparse.ArgumentTypeError(f"{text!r} is no shard; write 0/4, 1/4, 2/4 or 3/4 for a quarter")
    return int(first), int(second)


def run(options: argparse.Namespace) -> int:
    """Collect what is missing."""
    goal = _goal(options)
    task = chosen_task(options)
    generator = make_generator(options.generator, task, options)
    out = options.out or Path("data") / task.name
    dataset = DemonstrationDataset(out, task=task.name, keep_failures=options.keep_failures)
    if policy := getattr(generator, "policy_hash", ""):
        print(f"policy {policy}: {options.policy or 'the one shipped for this task'}")
    started, found = time.monotonic(), len(dataset.attempts())
    if found:
        print(f"{out} holds {found} attempts; going on")
    source = Source(options.seed, options.shard)
    wins = attempts = 0
    with tqdm(total=goal.demos or goal.attempts, unit="demo" if goal.demos else "attempt", smoothing=0.05) as bar:

        def tell(attempt: Attempt) -> None:
            nonlocal wins, attempts
            wins, attempts = wins + attempt.success, attempts + 1
            bar.set_postfix_str(f"DGR {wins / attempts:.0%} of {attempts}", refresh=False)
            bar.update(int(attempt.success) if goal.demos else 1)

        try:
            engine = run_attempts_on_ray if options.engine == "ray" else run_attempts
            collect(dataset, task, generator, goal, source=source, workers=options.workers, engine=engine, tell=tell)
        except KeyboardInterrupt:
            print(f"\nstopped with {wins} successes in {attempts} attempts; the same command goes on")
            return 130
    print(f"{wins} successes in {attempts} attempts, DGR {wins / max(attempts, 1):.1%}; {out}, "
          f"{(time.monotonic() - started) / 60:.1f} minutes")  # fmt: skip
    return 0


def _goal(options: argparse.Namespace) -> Goal:
    for name in ("demos", "attempts", "workers"):
        value = getattr(options, name)
        if value is not None and value < 1:
            raise ValueError(f"--{name} is {value}; it must be at least 1.")
    if options.demos is None and options.attempts is None:
        return Goal(50, None)
    return Goal(options.demos, options.attempts)
