"""Attempts on all cores; each of them comes back with an outcome."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from dynaforge.demos import Attempt, Episode
from dynaforge.generators.generator import Generator, make_env
from dynaforge.sampling.jobs import Workers, in_order
from dynaforge.sampling.processes import NoWorkers, kill_pool, started_pool, usable_cores, worker_pool
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome, Task
from dynaforge.tasks.user_code import in_one_line

TIMEOUT = 120.0  # seconds of wall time after which an attempt counts as hanging
ATTEMPTS_PER_WORKER = 2  # attempts given to each worker, so that it never waits for the next


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One attempt and its recording, if it left one."""

    attempt: Attempt
    episode: Episode | None

    def in_block(self, block: int) -> Result:
        """Return the same attempt as part of a block of conditions."""
        return replace(self, attempt=replace(self.attempt, block=block))


# The state of a worker process:
_env: Any = None
_generator: Generator | None = None
_start_error = ""  # why there is no env


def run_attempts(
    task: Task,
    generator: Generator,
    conditions: Iterable[Condition],
    *,
    block: int = 0,
    workers: int | None = None,
) -> Iterator[Result]:
    """Attempt every condition and yield the results in order.

    An exception or the death of a worker is a failed attempt with a reason, so no attempt goes uncounted.

    Args:
        task: The task.
        generator: What attempts the conditions.
        conditions: May be endless if the caller stops iterating.
        block: Block number noted with every attempt.
        workers: Number of processes; by default one per core that this process may use.

    Raises:
        NoWorkers: Workers cannot start, or the env cannot be made in them; the message says why.
    """
    yield from in_one_block(_Processes(task, generator, workers or usable_cores()), conditions, block=block)


def in_one_block(
    workers: Workers[Condition, Result], conditions: Iterable[Condition], *, block: int
) -> Iterator[Result]:
    """Attempt every condition and yield the results in order; the workers end with the iteration.

    Args:
        workers: What makes the attempts.
        conditions: May be endless if the caller stops iterating.
        block: Block number noted with every attempt.
    """
    with closing(in_order(workers, conditions)) as results:
        for result in results:
            yield result.in_block(block)


class _Processes:
    """Worker processes on this machine."""

    def __init__(self, task: Task, generator: Generator, size: int) -> None:
        self.running: list[tuple[Condition, Future[Result]]] = []
        self._size, self._task, self._generator = size, task, generator
        self._pool = self._new_pool()

    def hand_out(self, source: Iterator[Condition]) -> None:
        for condition in islice(source, ATTEMPTS_PER_WORKER * self._size - len(self.running)):
            self._submit(condition)

    def next_result(self) -> Result:
        condition, future = self.running.pop(0)
        try:
            return future.result(timeout=TIMEOUT)
        except TimeoutError:
            result = self._failed(condition, f"it ran for {TIMEOUT:g} s")
        except BrokenProcessPool:
            result = self._attempt_alone(condition)  # only this shows whether this attempt killed the worker
        self.kill()
        self._pool = self._new_pool()
        waiting, self.running = [waiting for waiting, _ in self.running], []
        for condition in waiting:
            self._submit(condition)
        return result

    def kill(self) -> None:
        kill_pool(self._pool)

    def _new_pool(self) -> ProcessPoolExecutor:
        return worker_pool(self._size, _start, self._task, self._generator)

    def _submit(self, condition: Condition) -> None:
        try:
            future = self._pool.submit(_attempt, condition)
        except BrokenProcessPool as error:  # a worker died meanwhile; `next_result` deals with it in turn
            future = Future()
            future.set_exception(error)
        self.running.append((condition, future))

    def _attempt_alone(self, condition: Condition) -> Result:
        """Attempt a condition in a process of its own."""
        try:
            with started_pool(1, _start, self._task, self._generator, timeout=TIMEOUT) as pool:
                return pool.submit(_attempt, condition).result(timeout=TIMEOUT)
        except (BrokenProcessPool, TimeoutError) as error:
            return self._failed(condition, type(error).__name__)

    def _failed(self, condition: Condition, problem: str) -> Result:
        return failed_attempt(condition, self._generator.name, f"worker lost: {problem}")


def _start(task: Task, generator: Generator) -> None:
    global _env, _generator, _start_error
    _generator = generator
    try:
        _env = make_env(generator, task)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - here it would only end the worker; the first attempt raises it
        _start_error = in_one_line(error)


def _attempt(condition: Condition) -> Result:
    assert _generator is not None
    if _start_error:
        raise NoWorkers(_start_error)
    return attempt_once(_env, _generator, condition)


def attempt_once(env: Any, generator: Generator, condition: Condition) -> Result:
    """Attempt a condition in this process; an exception is a failed attempt with a reason.

    Args:
        env: The env that `make_env` made for the generator.
        generator: What attempts the condition.
        condition: The condition.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        episode = generator.attempt(env, condition)
        result = Result(Attempt.of(episode), episode)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a failed attempt, never a missing one
        result = failed_attempt(condition, generator.name, f"exception: {type(error).__name__}: {error}")
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return replace(result, attempt=replace(result.attempt, wall_seconds=wall, cpu_seconds=cpu))


def failed_attempt(condition: Condition, generator: str, reason: str) -> Result:
    """Return the result of an attempt that left no episode.

    Args:
        condition: What was attempted.
        generator: Name of the generator.
        reason: Why it failed.
    """
    outcome = Outcome(success=False, checkpoint=0, failure=reason)
    return Result(Attempt(condition=condition, generator=generator, outcome=outcome, duration=0.0), None)
