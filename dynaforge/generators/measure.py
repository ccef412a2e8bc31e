"""Attempts that are only counted, as `evaluate` and `forge` do to measure a generator."""

from __future__ import annotations

from collections.abc import Iterable

from tqdm import tqdm

from dynaforge.demos import Attempt
from dynaforge.generators.attempts import Result, run_attempts
from dynaforge.generators.generator import Generator
from dynaforge.generators.giving_up import refuse_if_all_raise
from dynaforge.sim import Condition
from dynaforge.tasks import Task


def measure(
    task: Task, generator: Generator, blocks: Iterable[Iterable[Condition]], *, total: int, workers: int | None = None
) -> list[Attempt]:
    """Attempt conditions, with a progress bar, and return the attempts without recordings.

    Args:
        task: The task.
        generator: What attempts the conditions.
        blocks: The conditions of block 0, block 1 and so on.
        total: Number of conditions in all, for the bar.
        workers: Number of processes; by default one per core that this process may use.

    Raises:
        GaveUp: The generator only raises, so that there is nothing to measure.
    """

    def results() -> Iterable[Result]:
        for block, conditions in enumerate(blocks):
            yield from run_attempts(task, generator, conditions, block=block, workers=workers)

    measured = refuse_if_all_raise(iter(results()), generator=generator.name)
    bar = tqdm(measured, total=total, leave=False, unit="attempt", desc=generator.name)
    return [result.attempt for result in bar]
