"""Attempts made only to be counted: what `evaluate` and `forge` measure."""

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
    """Attempt conditions, with a progress bar, and keep the ledger's line of each.

    Args:
        task: What is attempted.
        generator: What attempts it.
        blocks: Conditions of block 0, 1 and so on.
        total: Conditions in all, for the bar.
        workers: Processes; by default one per core that this process may use.

    Raises:
        GaveUp: The generator only raises, so that there is nothing to measure.
    """

    def results() -> Iterable[Result]:
        for block, conditions in enumerate(blocks):
            yield from run_attempts(task, generator, conditions, block=block, workers=workers)

    sound = refuse_if_all_raise(iter(results()), generator=generator.name)
    return [r.attempt for r in tqdm(sound, total=total, leave=False, unit="attempt", desc=generator.name)]
