"""Attempts that are only counted, as `evaluate` and `forge` do to measure a generator."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from typing import Protocol

from tqdm import tqdm

from dynaforge.demos import Attempt
from dynaforge.evaluation.sequential import SequentialTest
from dynaforge.generators.attempts import run_attempts
from dynaforge.generators.collecting import Engine
from dynaforge.generators.generator import Generator
from dynaforge.generators.giving_up import refuse_if_all_raise
from dynaforge.sim import Condition
from dynaforge.tasks import Task


class Succeeding(Protocol):
    """An attempt of which only its success matters."""

    @property
    def success(self) -> bool:
        """Whether it succeeded."""


Until = Callable[[Succeeding], bool]
"""Called with every attempt in the order of the conditions; where it returns True, that attempt is the last one."""


def never(attempt: Succeeding) -> bool:
    """Let every condition be attempted."""
    return False


def ends_when_decided(reference: Iterable[Succeeding]) -> Until:
    """Return what ends a generator's attempts as soon as it is decided whether it succeeds more often, or less.

    Args:
        reference: The attempts of another generator on the same conditions in the same order, all of them.
    """
    test, others = SequentialTest(), iter(reference)
    return lambda attempt: test.push(float(attempt.success) - float(next(others).success))


def measure(
    task: Task,
    generator: Generator,
    blocks: Iterable[Iterable[Condition]],
    *,
    total: int,
    workers: int | None = None,
    engine: Engine | None = None,
    until: Until = never,
) -> list[Attempt]:
    """Attempt conditions, with a progress bar, and return the attempts without recordings.

    Args:
        task: The task.
        generator: What attempts the conditions.
        blocks: The conditions of block 0, block 1 and so on.
        total: Number of conditions in all, for the bar.
        workers: Number of processes or actors; by default one per core that the engine may use.
        engine: What runs attempts; by default `run_attempts`.
        until: Where it returns True, no more attempts are made, and those still in progress are dropped.

    Raises:
        GaveUp: The generator only raises, so that there is nothing to measure.
    """

    block_of: deque[int] = deque()  # of the attempts in progress

    def conditions() -> Iterator[Condition]:
        for block, drawn in enumerate(blocks):
            for condition in drawn:
                block_of.append(block)
                yield condition

    # One call for all blocks, since workers take longer to start than to make a block.
    run = engine or run_attempts
    results = (result.in_block(block_of.popleft()) for result in run(task, generator, conditions(), workers=workers))
    attempts: list[Attempt] = []
    with (
        closing(refuse_if_all_raise(results, generator=generator.name)) as measured,
        tqdm(measured, total=total, leave=False, unit="attempt", desc=generator.name) as bar,
    ):
        for result in bar:
            attempts.append(result.attempt)
            if until(result.attempt):
                break
    return attempts
