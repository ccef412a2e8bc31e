"""`dynaforge collect`: demonstrations into a folder; any interruption costs the attempts under way."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from tqdm import tqdm

from dynaforge.cli.evaluate import make_generator
from dynaforge.cli.task_arguments import chosen_task
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.generators import Goal, Source, collect, run_attempts
from dynaforge.generators.ray_engine import run_attempts_on_ray


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
    if options.demos is None and options.attempts is None:
        return Goal(50, None)
    return Goal(options.demos, options.attempts)
