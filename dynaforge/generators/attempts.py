"""Runs attempts on all cores; every one of them comes back with an outcome."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from dynaforge.demos import Attempt, Episode
from dynaforge.generators.generator import Generator, make_env
from dynaforge.sampling.processes import guard_hint, kill_pool, usable_cores, worker_pool
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome, Task
from dynaforge.tasks.user_code import in_one_line

TIMEOUT = 120.0  # seconds of wall time after which an attempt is taken to hang


class NoWorkers(RuntimeError):  # noqa: N818  the name says what happened
    """Whatever would run attempts does not even start."""


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One attempt and, if it left one, its recording."""

    attempt: Attempt
    episode: Episode | None

    def in_block(self, block: int) -> Result:
        """Return the same attempt as one of a block of conditions."""
        return replace(self, attempt=replace(self.attempt, block=block))


_env: Any = None
_generator: Generator | None = None
_fault = ""  # why there is no env


def run_attempts(
    task: Task,
    generator: Generator,
    conditions: Iterable[Condition],
    *,
    block: int = 0,
    workers: int | None = None,
) -> Iterator[Result]:
    """Attempt every condition and yield the results in order.

    An exception or the death of a worker is a failed attempt with a reason: nothing leaves the denominator.

    Args:
        task: The task.
        generator: What attempts.
        conditions: May be endless if the caller stops iterating.
        block: Block number noted with every attempt.
        workers: Processes; by default as many as the cores that this process may use.

    Raises:
        NoWorkers: Workers cannot even start, or the generator cannot be made in them; says why.
    """
    source = iter(conditions)
    crew = _Crew(task, generator, workers or usable_cores())
    try:
        crew.hand_out(islice(source, 2 * crew.size))
        while crew.running:
            yield crew.next_result().in_block(block)
            crew.hand_out(islice(source, 1))
    finally:
        crew.kill()


class _Crew:
    """Worker processes and the conditions they were handed, oldest first; a dead worker is replaced."""

    def __init__(self, task: Task, generator: Generator, size: int) -> None:
        self.size = size
        self.running: list[tuple[Condition, Future[Result]]] = []
        self._task, self._generator = task, generator
        self._pool = self._make(size)

    def hand_out(self, conditions: Iterable[Condition]) -> None:
        for condition in conditions:
            try:
                future = self._pool.submit(_attempt, condition)
            except BrokenProcessPool as error:  # a worker died meanwhile: its condition finds that out in its turn
                future = Future()
                future.set_exception(error)
            self.running.append((condition, future))

    def next_result(self) -> Result:
        condition, future = self.running.pop(0)
        try:
            return future.result(timeout=TIMEOUT)
        except TimeoutError:
            result = self._lost(condition, f"it ran for {TIMEOUT:g} s")
        except BrokenProcessPool:
            result = self._alone(condition)  # who killed the worker is known only of a condition that runs alone
        self.kill()
        self._pool = self._make(self.size)
        waiting, self.running = [c for c, _ in self.running], []
        self.hand_out(waiting)
        return result

    def kill(self) -> None:
        kill_pool(self._pool)

    def _make(self, size: int) -> ProcessPoolExecutor:
        return worker_pool(size, _start, self._task, self._generator)

    def _alone(self, condition: Condition) -> Result:
        pool = self._make(1)
        try:
            try:
                pool.submit(_ready).result(timeout=TIMEOUT)
            except BrokenProcessPool as error:
                raise NoWorkers(f"Worker processes die as they start.{guard_hint()}") from error
            return pool.submit(_attempt, condition).result(timeout=TIMEOUT)
        except (BrokenProcessPool, TimeoutError) as error:
            return self._lost(condition, type(error).__name__)
        finally:
            kill_pool(pool)

    def _lost(self, condition: Condition, why: str) -> Result:
        return lost(condition, self._generator.name, f"worker lost: {why}")


def _start(task: Task, generator: Generator) -> None:
    global _env, _generator, _fault
    _generator = generator
    try:
        _env = make_env(generator, task)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - told by the first attempt: here it would only end the worker
        _fault = in_one_line(error)


def _ready() -> None:
    """Do nothing: a worker that can has started."""


def _attempt(condition: Condition) -> Result:
    assert _generator is not None
    if _fault:
        raise NoWorkers(_fault)
    return attempt_once(_env, _generator, condition)


def attempt_once(env: Any, generator: Generator, condition: Condition) -> Result:
    """Attempt a condition in this process; an exception is a failed attempt with a reason."""
    start = time.perf_counter()
    try:
        episode = generator.attempt(env, condition)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a failed attempt, never a missing one
        return lost(condition, generator.name, f"exception: {type(error).__name__}: {error}")
    return Result(Attempt.of(episode, wall_seconds=time.perf_counter() - start), episode)


def lost(condition: Condition, generator: str, reason: str) -> Result:
    """Return the failed attempt that stands for one that left nothing."""
    outcome = Outcome(success=False, checkpoint=0, failure=reason)
    return Result(Attempt(condition=condition, generator=generator, outcome=outcome, duration=0.0), None)
