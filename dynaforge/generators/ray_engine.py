"""Attempts on an existing Ray cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

from dynaforge.generators.attempts import (
    ATTEMPTS_PER_WORKER,
    TIMEOUT,
    Result,
    attempt_once,
    failed_attempt,
    in_one_block,
)
from dynaforge.generators.generator import Generator, make_env
from dynaforge.sampling.ray_jobs import RayJobs
from dynaforge.sim import Condition
from dynaforge.tasks import Task


class _Attempting:
    """Makes attempts in an env of its own."""

    def __init__(self, task: Task, generator: Generator) -> None:
        self._env, self._generator = make_env(generator, task), generator

    def __call__(self, condition: Condition) -> Result:
        return attempt_once(self._env, self._generator, condition)


def run_attempts_on_ray(
    task: Task, generator: Generator, conditions: Iterable[Condition], *, block: int = 0, workers: int | None = None
) -> Iterator[Result]:
    """Attempt every condition on a running Ray cluster and yield the results in order.

    An attempt depends only on its condition, so those of an actor or a node that died are repeated by others. An
    attempt during which one actor after another dies is a failed attempt.

    Args:
        task: The task; dynaforge must be installed on every node.
        generator: What attempts the conditions.
        conditions: May be endless if the caller stops iterating.
        block: Block number noted with every attempt.
        workers: Number of actors, one core each; by default one per core of the cluster.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
        NoWorkers: No actor becomes ready.
    """

    def failed(condition: Condition, problem: str) -> Result:
        return failed_attempt(condition, generator.name, problem)

    actors = RayJobs(
        partial(_Attempting, task, generator),
        failed=failed,
        size=workers,
        queued=ATTEMPTS_PER_WORKER,
        timeout=TIMEOUT,
    )
    yield from in_one_block(actors, conditions, block=block)
