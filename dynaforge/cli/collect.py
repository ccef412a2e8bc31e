"""`dynaforge collect`: demonstrations into a folder; an interruption costs only the attempts in progress."""

from __future__ import annotations

import argparse
import sys
import time

from dynaforge.cli.arguments.tasks import chosen_task
from dynaforge.cli.engine import on_ray
from dynaforge.cli.evaluate import generator_of
from dynaforge.cli.tally import Tally
from dynaforge.demos import DemonstrationDataset
from dynaforge.generators import ConditionSource, GaveUp, Goal, ResidualGenerator, collect, run_attempts
from dynaforge.generators.by_name import setting_line
from dynaforge.generators.giving_up import describe_counts
from dynaforge.generators.ray_engine import run_attempts_on_ray


def run(options: argparse.Namespace) -> int:
    """Collect what is missing; return 1 when that is less than was asked for."""
    goal = _goal(options)
    engine = run_attempts_on_ray if on_ray(options) else run_attempts
    task = chosen_task(options)
    generator = generator_of(options.generator, task, options)
    print(f"{task.name}: {setting_line(task, [generator])}")
    out = options.out
    dataset = DemonstrationDataset(out, task=task.name, keep_failures=options.keep_failures)
    if isinstance(generator, ResidualGenerator):
        print(f"policy {generator.policy_hash}: {options.policy or 'the one shipped for this task'}")
    started, found = time.monotonic(), len(dataset.attempts())
    if found:
        print(f"{out} holds {found} attempts; resuming")
    source, problem = ConditionSource(options.seed, options.shard), ""
    with Tally(goal) as tally:
        try:
            collect(
                dataset,
                task,
                generator,
                goal,
                source=source,
                workers=options.workers,
                engine=engine,
                on_attempt=tally.add,
            )
        except KeyboardInterrupt:
            print(f"\nstopped with {tally}; the same command resumes")
            return 130
        except GaveUp as error:
            problem = f"{error}. Another --policy may succeed; --give-up-after N allows N of them, 0 any number"
    minutes = (time.monotonic() - started) / 60
    print(f"{tally}, DGR {tally.rate:.1%}; {out}, {minutes:.1f} minutes")
    if not problem and goal.demos is not None and tally.successes < goal.demos:
        problem = (
            f"Only {tally.successes} of {goal.demos} demonstrations in {goal.attempts} attempts; "
            f"{describe_counts(tally.reasons)}. With more --attempts the same command resumes"
        )
    if problem:
        print(f"dynaforge collect: {problem}.", file=sys.stderr)
    return 1 if problem else 0


def _goal(options: argparse.Namespace) -> Goal:
    if options.demos is None and options.attempts is None:
        return Goal(50, None, options.give_up_after)
    return Goal(options.demos, options.attempts, options.give_up_after)
