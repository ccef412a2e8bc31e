"""Runs attempts on all cores; every one of them comes back with an outcome."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from itertools import islice

from dynaforge.demos import Attempt, Episode
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.generator import Generator
from dynaforge.sim import Condition
from dynaforge.tasks import Task

TIMEOUT = 120.0  # seconds of wall time after which an attempt is taken to hang


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One attempt and, if it left one, its recording."""

    attempt: Attempt
    episode: Episode | None


_env: ResidualEnv | None = None
_generator: Generator | None = None


def run_attempts(
    task: Task,
    generator: Generator,
    conditions: Iterable[Condition],
    *,
    block: int = 0,
    workers: int | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[Result]:
    """Attempt every condition and yield the results in order.

    An exception or the death of a worker is a failed attempt with a reason: nothing leaves the denominator.

    Args:
        task: The task.
        generator: What attempts.
        conditions: May be endless if `stop` ends it.
        block: Block number noted with every attempt.
        workers: Processes; all cores by default.
        stop: Asked before another condition is handed out.
    """
    source = iter(conditions)
    workers = workers or os.cpu_count() or 1
    pool = _pool(task, generator, workers)
    try:
        running = [(c, pool.submit(_attempt, c)) for c in islice(source, 2 * workers)]
        while running:
            condition, future = running.pop(0)
            try:
                result = future.result(timeout=TIMEOUT)
            except (BrokenProcessPool, TimeoutError) as error:
                result = _lost(condition, generator.name, f"worker lost: {type(error).__name__}")
                _kill(pool)
                pool = _pool(task, generator, workers)
                running = [(c, pool.submit(_attempt, c)) for c, _ in running]
            yield replace(result, attempt=replace(result.attempt, block=block))
            if not stop():
                running += [(c, pool.submit(_attempt, c)) for c in islice(source, 1)]
    finally:
        _kill(pool)


def _pool(task: Task, generator: Generator, workers: int) -> ProcessPoolExecutor:
    context = multiprocessing.get_context("forkserver")
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_start, initargs=(task, generator))


def _kill(pool: ProcessPoolExecutor) -> None:
    processes = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(2.0)


def _start(task: Task, generator: Generator) -> None:
    global _env, _generator
    _env, _generator = ResidualEnv(task), generator


def _attempt(condition: Condition) -> Result:
    assert _env is not None
    assert _generator is not None
    start = time.perf_counter()
    try:
        episode = _generator.attempt(_env, condition)
    except Exception as error:  # noqa: BLE001 - an attempt that raises is a failed attempt, never a missing one
        return _lost(condition, _generator.name, f"exception: {type(error).__name__}: {error}")
    return Result(Attempt.of(episode, wall_seconds=time.perf_counter() - start), episode)


def _lost(condition: Condition, generator: str, reason: str) -> Result:
    attempt = Attempt(condition, generator, success=False, checkpoint=0, failure=reason, phase="", duration=0.0)
    return Result(attempt, None)
