"""Collecting demonstrations: attempt the conditions of a stream until there are enough; resume after any interruption.

Attempts of the generator that the folder already contains count toward the goal and are not made again, so the same
call resumes after an interruption, which costs only the attempts in progress. Attempts in progress when the goal is
reached are recorded too: whether an attempt counts must not depend on how it ends. The attempts are therefore a prefix
of the stream. The same is true of giving up, unless one of the attempts in progress succeeds after all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.demos.provenance import Provenance
from dynaforge.generators.attempts import Result, run_attempts
from dynaforge.generators.generator import Generator, attempted_task
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
        demos: Number of successes to collect; None for no limit.
        attempts: Number of attempts at most, successful or not; None for no limit.
        give_up_after: Attempts in a row without a success after which collecting gives up; 0 for never. By default 20
            for each of `demos`, and at least 50; never where `demos` is None, since failures are asked for too then.
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

    def reached(self, done: Sequence[Attempt], in_progress: int) -> bool:
        """Return whether no attempt is needed besides those done and those in progress."""
        enough = self.demos is not None and sum(attempt.success for attempt in done) >= self.demos
        return enough or (self.attempts is not None and len(done) + in_progress >= self.attempts)

    def should_give_up(self, failures: int) -> bool:
        """Return whether so many failures in a row are too many."""
        limit = self.give_up_after
        if limit is None:
            limit = 0 if self.demos is None else max(MIN_ATTEMPTS, 20 * self.demos)
        return 0 < limit <= failures


@dataclass(frozen=True, slots=True)
class ConditionSource:
    """Conditions to attempt: a block of a stream, or a share of it.

    Attributes:
        block: Block of the stream "train".
        shard: (i, n) takes every n-th condition from the i-th on; collectors with different i have none in common.
    """

    block: int = 0
    shard: tuple[int, int] = (0, 1)

    def __post_init__(self) -> None:
        check_whole("ConditionSource: block", self.block, least=0)
        check_shard(self.shard)

    def conditions(self, task: Task) -> Iterator[Condition]:
        """Return the conditions, an endless stream."""
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
    """Attempt conditions until the goal is reached, and record each attempt as it ends.

    Args:
        dataset: A dataset opened for adding. Attempts of this generator that it contains already count, too.
        task: The task.
        generator: What attempts the conditions.
        goal: When to end.
        source: The conditions; by default block 0.
        workers: Number of processes; by default one per core.
        engine: What runs attempts: `run_attempts` or `run_attempts_on_ray`.
        on_attempt: Called with every attempt, those found in the folder first.

    Returns:
        All attempts of this generator at these conditions that the folder now contains.

    Raises:
        ValueError: The folder contains attempts of another policy, with another definition of the task or under another
            setting; or an argument is malformed.
        GaveUp: Too many attempts in a row failed, see `Goal`.
    """
    source = ConditionSource() if source is None else source
    _check_arguments(dataset, task, goal, source, workers)
    dataset.note_source(generator.name, _provenance(generator, task))
    progress = _Progress(dataset, generator.name, goal, source.conditions(task), on_attempt)
    while not progress.reached:
        progress.check_failures()
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
    file, task = task_file_name(task), attempted_task(generator, task)
    policy = getattr(generator, "policy_hash", "")
    return Provenance(policy, task_digest(task), file, task.setting, task.lead_time)


class _Progress:
    """How far collecting has come along its stream of conditions.

    Args:
        dataset: Where attempts are recorded. Complete attempts of the generator that it contains are not made again.
        generator: Name of the generator.
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
        self._in_progress = 0
        self._failures = 0  # in a row
        self.done: list[Attempt] = []

    @property
    def reached(self) -> bool:
        """Whether the goal needs no attempt besides those done and those in progress."""
        return self._goal.reached(self.done, self._in_progress)

    def check_failures(self) -> None:
        """Raise GaveUp if too many attempts in a row failed."""
        if self._goal.should_give_up(self._failures):
            raise GaveUp(f"No success in {self._failures} attempts in a row by {self._generator!r}", self.done)

    def missing(self) -> Iterator[Condition]:
        """Yield the conditions still to be attempted, until the goal is reached or too many attempts failed."""
        for condition in self._conditions:
            if condition.id in self._found:
                self._note(self._found[condition.id])
            elif self.reached or self._goal.should_give_up(self._failures):
                # The attempts in progress decide whether this condition is needed after all.
                self._conditions = chain((condition,), self._conditions)
                return
            else:
                self._in_progress += 1
                yield condition

    def record(self, result: Result) -> None:
        """Record an attempt at a condition that `missing` yielded."""
        attempt = self._dataset.record(result.attempt, result.episode)
        self._in_progress -= 1
        self._note(attempt)

    def _note(self, attempt: Attempt) -> None:
        self._failures = 0 if attempt.success else self._failures + 1
        self.done.append(attempt)
        self._on_attempt(attempt)
