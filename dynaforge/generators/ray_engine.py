"""The same attempts on an existing Ray cluster: actors instead of worker processes, replaced when they die."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

from dynaforge.envs.processes import SINGLE_THREAD
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.attempts import TIMEOUT, Result, attempt_once, lost
from dynaforge.generators.generator import Generator
from dynaforge.sim import Condition
from dynaforge.tasks import Task

RECOVERY = 60.0  # seconds that an actor which died, perhaps with its whole node, has to come back and end the attempt
AHEAD = 2  # attempts handed to an actor, so that it never waits for the next


class _Attempter:
    """The actor: an env of its own, attempt after attempt."""

    def __init__(self, task: Task, generator: Generator) -> None:
        self._env, self._generator = ResidualEnv(task), generator

    def attempt(self, condition: Condition) -> Result:
        return attempt_once(self._env, self._generator, condition)


def run_attempts_on_ray(
    task: Task, generator: Generator, conditions: Iterable[Condition], *, block: int = 0, workers: int | None = None
) -> Iterator[Result]:
    """Attempt every condition on a running Ray cluster and yield the results in order.

    Ray restarts an actor that died, on another node if its own is gone, and the attempt is repeated: work is keyed by
    condition, so that is harmless. An attempt that takes its actor down again and again is a failed attempt.

    Args:
        task: The task; dynaforge must be installed on every node.
        generator: What attempts.
        conditions: May be endless if the caller stops iterating.
        block: Block number noted with every attempt.
        workers: Actors, one core each; all cores of the cluster by default.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
    """
    ray = _connected()
    count = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
    make = ray.remote(num_cpus=1, max_restarts=-1, runtime_env={"env_vars": SINGLE_THREAD})(_Attempter)
    actors = [make.remote(task, generator) for _ in range(count)]
    load = [0] * count
    running: deque[tuple[Condition, int, Any]] = deque()
    source = iter(conditions)

    def hand_out(n: int) -> None:
        for condition in islice(source, n):
            k = load.index(min(load))
            load[k] += 1
            running.append((condition, k, actors[k].attempt.remote(condition)))

    try:
        hand_out(AHEAD * count)
        while running:
            condition, k, reference = running.popleft()
            result = _result(ray, actors[k], condition, reference, generator.name)
            load[k] -= 1
            yield replace(result, attempt=replace(result.attempt, block=block))
            hand_out(1)
    finally:
        for actor in actors:
            ray.kill(actor)


def _result(ray: Any, actor: Any, condition: Condition, reference: Any, name: str) -> Result:
    """Wait for an attempt; while its actor is being restarted, ask again."""
    fell: float | None = None
    while True:
        try:
            result: Result = ray.get(reference, timeout=TIMEOUT)
            return result
        except ray.exceptions.GetTimeoutError:
            ray.kill(actor, no_restart=False)  # it is still at it, and would keep all that follows waiting
            return lost(condition, name, f"worker lost: it ran for {TIMEOUT:g} s")
        except ray.exceptions.RayError as error:
            fell = fell or time.monotonic()
            if time.monotonic() - fell > RECOVERY:
                return lost(condition, name, f"worker lost: {type(error).__name__}")
            time.sleep(1.0)
            reference = actor.attempt.remote(condition)


def _connected() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ImportError("Engine ray needs Ray: pip install 'dynaforge[ray]'.") from error
    if not ray.is_initialized():
        try:
            ray.init(address=os.environ.get("RAY_ADDRESS", "auto"), log_to_driver=False)
        except ConnectionError as error:
            raise ConnectionError(
                "No Ray cluster is running here: `ray start --head` begins one, RAY_ADDRESS names another; or leave "
                "out --engine ray to use the cores of this machine."
            ) from error
    return ray
