"""Collecting demonstrations: attempt conditions of a stream until there are enough; go on after any interruption.

What the folder already holds of a generator counts toward the goal and is not attempted again, so the same call goes
on after an interruption, which costs only the attempts under way. Attempts under way when the goal is reached are
recorded too: whether an attempt counts must not depend on how it ends. So the attempts are a prefix of the stream. The
same holds for giving up, unless one of those under way succeeds after all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.demos.dataset import Provenance
from dynaforge.generators.attempts import Result, run_attempts
from dynaforge.generators.generator import Generator
from dynaforge.generators.giving_up import MIN_ATTEMPTS, GaveUp
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

    def should_give_up(self, failures: int) -> bool:
        """Tell whether so many failures in a row are too many."""
        most = self.give_up_after
        if most is None:
            most = 0 if self.demos is None else max(MIN_ATTEMPTS, 20 * self.demos)
        return 0 < most <= failures


@dataclass(frozen=True, slots=True)
class ConditionSource:
    """Conditions to attempt: a block of a stream, or a share of it.

    Attributes:
        block: Which block of the stream "train".
        shard: (i, n): of every n conditions the i-th; collectors with different i never meet.
    """

    block: int = 0
    shard: tuple[int, int] = (0, 1)

    def __post_init__(self) -> None:
        check_whole("ConditionSource: block", self.block, least=0)
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
    source: ConditionSource | None = None,
    workers: int | None = None,
    engine: Engine = run_attempts,
    on_attempt: Callable[[Attempt], None] = lambda attempt: None,
) -> list[Attempt]:
    """Attempt conditions until the goal is reached, each attempt recorded as it ends.

    Args:
        dataset: Open for adding. What it holds of this generator counts, too.
        task: The task.
        generator: What attempts.
        goal: When to end.
        source: Conditions, by default block 0.
        workers: Processes; all cores by default.
        engine: What runs attempts: `run_attempts`, or `run_attempts_on_ray`.
        on_attempt: Called with every attempt, those found in the folder first.

    Returns:
        All attempts of this generator at these conditions that the folder now holds.

    Raises:
        ValueError: The folder holds attempts of another policy, or with another definition of the task; or an argument
            is malformed.
        GaveUp: So many attempts in a row failed that there is no hope, see `Goal`.
    """
    source = ConditionSource() if source is None else source
    _check_arguments(dataset, task, goal, source, workers)
    dataset.note_source(generator.name, _provenance(generator, task))
    progress = _Progress(dataset, generator.name, goal, source.conditions(task), on_attempt)
    while not progress.reached:
        progress.check_hope()
        for result in engine(task, generator, progress.missing(), block=source.block, workers=workers):
            progress.record(result)
    return progress.done


def _check_arguments(dataset: object, task: object, goal: object, source: object, workers: object) -> None:
    check_kind("dataset", dataset, DemonstrationDataset)
    check_kind("task", task, Task)
    check_kind("goal", goal, Goal)
    check_kind("source", source, ConditionSource)
    if workers is not None:
        check_whole("workers", workers, least=1)


def _provenance(generator: Generator, task: Task) -> Provenance:
    return Provenance(getattr(generator, "policy_hash", ""), task_digest(task), task_file_name(task))


class _Progress:
    """How far collecting has come along its stream of conditions.

    Args:
        dataset: Where attempts are recorded. What it holds of the generator, whole, is not attempted again.
        generator: Name of what attempts.
        goal: When to end.
        conditions: The stream.
        on_attempt: Called with every attempt, in the order of the stream.

    Attributes:
        done: All attempts, those found in the dataset included.
    """

    def __init__(
        self,
        dataset: DemonstrationDataset,
        generator: str,
        goal: Goal,
        conditions: Iterator[Condition],
        on_attempt: Callable[[Attempt], None],
    ) -> None:
        self._dataset, self._goal, self._conditions, self._on_attempt = dataset, goal, conditions, on_attempt
        missing = {attempt.id for attempt in dataset.missing_recordings() if attempt.success or dataset.keep_failures}
        found = (a for a in dataset.attempts() if a.generator == generator and a.id not in missing)
        self._found = {attempt.condition.id: attempt for attempt in found}
        self._generator = generator
        self._under_way = self._failures = 0  # the latter in a row
        self.done: list[Attempt] = []

    @property
    def reached(self) -> bool:
        """Whether the goal needs no attempt beside those done and under way."""
        return self._goal.reached(self.done, self._under_way)

    def check_hope(self) -> None:
        """Raise GaveUp if too many attempts in a row failed."""
        if self._goal.should_give_up(self._failures):
            raise GaveUp(f"No success in {self._failures} attempts in a row by {self._generator!r}", self.done)

    def missing(self) -> Iterator[Condition]:
        """Yield the conditions still to be attempted, for as long as there is need and hope."""
        for condition in self._conditions:
            if condition.id in self._found:
                self._note(self._found[condition.id])
            elif self.reached or self._goal.should_give_up(self._failures):
                # Those under way decide whether it is wanted after all.
                self._conditions = chain((condition,), self._conditions)
                return
            else:
                self._under_way += 1
                yield condition

    def record(self, result: Result) -> None:
        """Record an attempt at a condition that `missing` gave out."""
        attempt = self._dataset.record(result.attempt, result.episode)
        self._under_way -= 1
        self._note(attempt)

    def _note(self, attempt: Attempt) -> None:
        self._failures = 0 if attempt.success else self._failures + 1
        self.done.append(attempt)
        self._on_attempt(attempt)
