"""Measuring a generator: blocks of conditions, with one start of the workers for all of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

from dynaforge.generators import PlannerOnly, Result
from dynaforge.generators.attempts import failed_attempt
from dynaforge.generators.measure import measure
from dynaforge.sim import Condition
from dynaforge.tasks import get_task

CAN = get_task("can")


def test_the_attempts_of_all_blocks_come_from_one_call_and_bear_the_number_of_their_block() -> None:
    blocks = [list(islice(CAN.conditions.stream("val", block), n)) for block, n in enumerate((3, 1, 4))]
    asked_workers = []

    def engine(task: object, generator: object, conditions: Iterable[Condition], *, workers: int) -> Iterator[Result]:
        asked_workers.append(workers)
        source = iter(conditions)
        running = list(islice(source, 5))  # engines are ahead of their results
        while running:
            result = failed_attempt(running.pop(0), "planner_only", "dropped")
            episode = PlannerOnly()  # anything but None
            yield Result(result.attempt, episode)  # type: ignore[arg-type]
            running += islice(source, 1)

    measured = measure(CAN, PlannerOnly(), blocks, total=8, workers=7, engine=engine)
    assert [(a.block, a.condition.id) for a in measured] == [(k, c.id) for k, block in enumerate(blocks) for c in block]
    assert asked_workers == [7]
