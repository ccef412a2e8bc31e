"""Collecting demonstrations: attempt conditions of a stream until there are enough; go on after any interruption."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.demos.dataset import Provenance
from dynaforge.generators.attempts import Result, run_attempts
from dynaforge.generators.generator import Generator
from dynaforge.generators.giving_up import ENOUGH, GaveUp
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_kind, check_whole
from dynaforge.tasks import Task, task_file_name
from dynaforge.tasks.conditions import check_shard
from dynaforge.tasks.digest import task_digest

Engine = Callable[..., Iterator[Result]]


@dataclass(frozen=True, slots=True)
class Goal:
    """When collecting ends.

    Attributes:
        demos: Successes wanted; None for any number.
        attempts: Attempts at most, successful or not; None for any number.
        give_up_after: Attempts in a row without a success after which there is no hope; 0 for never. By default 20 for
            each of `demos`, at least 50; never where `demos` is None, since then failures are what is asked for too.
    """

    demos: int | None
    attempts: int | None
    give_up_after: int | None = None

    def __post_init__(self) -> None:
        if self.give_up_after is not None:
            check_whole("Goal: give_up_after", self.give_up_after, least=0)
        for name in ("demos", "attempts"):
            if getattr(self, name) is not None:
                check_whole(f"Goal: {name}", getattr(self, name), least=1)
        if self.demos is None and self.attempts is None:
            raise ValueError("Goal has neither demos nor attempts, so collecting would never end; give one of them.")

    def reached(self, done: Sequence[Attempt], under_way: int) -> bool:
        """Tell whether no other attempt is needed beside those done and those under way."""
        enough = self.demos is not None and sum(attempt.success for attempt in done) >= self.demos
        return enough or (self.attempts is not None and len(done) + under_way >= self.attempts)

    def hopeless(self, failures: int) -> bool:
        """Tell whether so many failures in a row are too many."""
        most = self.give_up_after
        if most is None:
            most = 0 if self.demos is None else max(ENOUGH, 20 * self.demos)
        return 0 < most <= failures


@dataclass(frozen=True, slots=True)
class Source:
    """Conditions to attempt: a block of a stream, or a share of it.

    Attributes:
        block: Which block of the stream "train".
        shard: (i, n): of every n conditions the i-th; collectors with different i never meet.
    """

    block: int = 0
    shard: tuple[int, int] = (0, 1)

    def __post_init__(self) -> None:
        check_whole("Source: block", self.block, least=0)
        check_shard(self.shard)

    def conditions(self, task: Task) -> Iterator[Condition]:
        """Iterate over the conditions, without end."""
        return task.conditions.stream("train", self.block, shard=self.shard)


def collect(
    dataset: DemonstrationDataset,
    task: Task,
    generator: Generator,
    goal: Goal,
    *,
    source: Source | None = None,
    workers: int | None = None,
    engine: Engine = run_attempts,
    tell: Callable[[Attempt], None] = lambda attempt: None,
) -> list[Attempt]:
    """Attempt conditions until the goal is reached, each attempt recorded as it ends.

    What the folder holds of this generator counts toward the goal and is not attempted again, so the same call goes on
    after an interruption, which costs the attempts under way; only what lost its recording is made again. Attempts
    under way when the goal is reached are recorded too: whether an attempt counts must not depend on how it ends. So
    the attempts are a prefix of the stream. The same holds for giving up, from which a success of those under way
    turns back; what was found in the folder counts toward it as well.

    Args:
        dataset: Open for adding.
        task: The task.
        generator: What attempts.
        goal: When to end.
        source: Conditions, by default block 0.
        workers: Processes; all cores by default.
        engine: What runs attempts: `run_attempts`, or `run_attempts_on_ray`.
        tell: Called with every attempt, those found in the folder first.

    Returns:
        All attempts of this generator at these conditions that the folder now holds.

    Raises:
        ValueError: The folder holds attempts of another policy, or with another definition of the task; or an argument
            is none.
        GaveUp: So many attempts in a row failed that there is no hope, see `Goal`.
    """
    for name, value, kind in (("dataset", dataset, DemonstrationDataset), ("task", task, Task), ("goal", goal, Goal)):
        check_kind(name, value, kind)
    check_kind("source", source, (Source, type(None)))
    if workers is not None:
        check_whole("workers", workers, least=1)
    made_by = Provenance(getattr(generator, "policy_hash", ""), task_digest(task), task_file_name(task))
    dataset.note_source(generator.name, made_by)
    lost = {attempt.id for attempt in dataset.lost() if attempt.success or dataset.keep_failures}
    held = {a.condition.id: a for a in dataset.attempts() if a.generator == generator.name and a.id not in lost}
    source = source or Source()
    done: list[Attempt] = []
    under_way = failures = 0  # the latter in a row
    conditions = source.conditions(task)

    def note(attempt: Attempt) -> None:
        nonlocal failures
        failures = 0 if attempt.success else failures + 1
        done.append(attempt)
        tell(attempt)

    def missing() -> Iterator[Condition]:
        nonlocal under_way, conditions
        for condition in conditions:
            if condition.id in held:
                note(held[condition.id])
            elif goal.reached(done, under_way) or goal.hopeless(failures):
                conditions = chain((condition,), conditions)  # those under way decide whether it is wanted after all
                return
            else:
                under_way += 1
                yield condition

    while True:
        for result in engine(task, generator, missing(), block=source.block, workers=workers):
            attempt = result.attempt
            if result.episode is None:
                dataset.record(attempt)
            else:
                dataset.add(result.episode, wall_seconds=attempt.wall_seconds, block=attempt.block)
            under_way -= 1
            note(attempt)
        if goal.reached(done, 0):
            return done
        if goal.hopeless(failures):
            raise GaveUp(f"No success in {failures} attempts in a row by {generator.name!r}", done)
