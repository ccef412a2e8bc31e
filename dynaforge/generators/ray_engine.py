"""Attempts on an existing Ray cluster, with actors instead of worker processes."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from dynaforge.generators.attempts import ATTEMPTS_PER_WORKER, TIMEOUT, Result, attempt_once, failed_attempt, in_order
from dynaforge.generators.generator import Generator, make_env
from dynaforge.sampling.processes import SINGLE_THREAD, NoWorkers
from dynaforge.sim import Condition
from dynaforge.tasks import Task
from dynaforge.tasks.task_file import VARIABLE

NO_ACTOR_TIMEOUT = 300.0  # seconds without any ready actor after which the run ends
MAX_ACTOR_DEATHS = 2  # actors that die during an attempt before it counts as failed


class _AttemptActor:
    """Makes attempts in an env of its own."""

    def __init__(self, task: Task, generator: Generator) -> None:
        self._env, self._generator = make_env(generator, task), generator

    def ready(self) -> None:
        """Return once the actor is ready."""

    def attempt(self, condition: Condition) -> Result:
        return attempt_once(self._env, self._generator, condition)


def run_attempts_on_ray(
    task: Task, generator: Generator, conditions: Iterable[Condition], *, block: int = 0, workers: int | None = None
) -> Iterator[Result]:
    """Attempt every condition on a running Ray cluster and yield the results in order.

    When an actor dies, its attempts go to the others, and a new actor takes its place as soon as the cluster has a core
    for it. An attempt depends only on its condition, so repeating it is harmless. An attempt during which one actor
    after another dies is a failed attempt.

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
    ray = connect_to_ray()
    count = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
    yield from in_order(_Actors(ray, task, generator, count), conditions, block=block)


@dataclass(slots=True, kw_only=True)
class _RunningAttempt:
    """An attempt in progress.

    Attributes:
        condition: Its condition.
        actor: Index of its actor; None while it waits for another.
        reference: Ray's reference to the result.
        alone: Whether the actor had just shown that it is ready and has nothing else to do.
        deaths: Number of actors that died while they had this attempt alone.
    """

    condition: Condition
    actor: int | None = None
    reference: Any = None
    alone: bool = False
    deaths: int = 0


class _Actors:
    """Actors on a Ray cluster."""

    def __init__(self, ray: Any, task: Task, generator: Generator, size: int) -> None:
        self.running: deque[_RunningAttempt] = deque()
        self._ray, self._name = ray, generator.name
        inherited = SINGLE_THREAD | {VARIABLE: os.environ.get(VARIABLE, "")}  # a user-defined task needs its file
        make = ray.remote(num_cpus=1, max_restarts=0, runtime_env={"env_vars": inherited})(_AttemptActor)
        self._make: Callable[[], Any] = lambda: make.remote(task, generator)
        self._actors: list[Any] = [None] * size
        self._starting: dict[int, Any] = {}
        self._load = [0] * size
        for k in range(size):
            self._start(k)

    def hand_out(self, source: Iterator[Condition]) -> None:
        """Give every ready actor as many attempts as it may have; wait for an actor if none is ready."""
        while (k := self._least_loaded(wait=not self.running)) is not None and self._load[k] < ATTEMPTS_PER_WORKER:
            condition = next(source, None)
            if condition is None:
                return
            self.running.append(_RunningAttempt(condition=condition))
            self._assign(self.running[-1], k)

    def next_result(self) -> Result:
        """Wait for the oldest attempt.

        The death of an actor counts against an attempt only if the actor was ready and had no other attempt: a failing
        node takes many actors down at once, and another attempt may have been the cause.
        """
        while True:
            attempt = self.running[0]
            assert attempt.actor is not None
            try:
                result: Result = self._ray.get(attempt.reference, timeout=TIMEOUT)
                self._load[attempt.actor] -= 1
            except self._ray.exceptions.GetTimeoutError:
                self._replace(attempt.actor)
                result = failed_attempt(attempt.condition, self._name, f"worker lost: it ran for {TIMEOUT:g} s")
            except self._ray.exceptions.RayError as error:
                attempt.deaths += attempt.alone
                self._replace(attempt.actor)
                if attempt.deaths < MAX_ACTOR_DEATHS:
                    self._assign(attempt, self._idle_actor(), alone=True)
                    self._reassign_waiting()
                    continue
                result = failed_attempt(attempt.condition, self._name, f"worker lost: {type(error).__name__}")
            self.running.popleft()
            self._reassign_waiting()
            return result

    def kill(self) -> None:
        for actor in self._actors:
            self._ray.kill(actor)

    def _start(self, k: int) -> None:
        self._actors[k], self._load[k] = self._make(), 0
        self._starting[k] = self._actors[k].ready.remote()

    def _assign(self, attempt: _RunningAttempt, k: int, *, alone: bool = False) -> None:
        self._load[k] += 1
        attempt.actor, attempt.alone, attempt.reference = k, alone, self._actors[k].attempt.remote(attempt.condition)

    def _reassign_waiting(self) -> None:
        """Give the attempts of dead actors to those that are ready."""
        for attempt in self.running:
            if attempt.actor is None:
                k = self._least_loaded(wait=True)
                assert k is not None
                self._assign(attempt, k)

    def _replace(self, k: int) -> None:
        """Replace an actor that died or hangs; its attempts wait for another."""
        self._ray.kill(self._actors[k])
        self._start(k)
        for attempt in self.running:
            if attempt.actor == k:
                attempt.actor = None

    def _idle_actor(self) -> int:
        """Wait until an actor shows that it is ready and has finished its attempts; return its index."""
        while True:
            k = self._least_loaded(wait=True)
            assert k is not None
            try:
                self._ray.get(self._actors[k].ready.remote(), timeout=TIMEOUT)
            except (self._ray.exceptions.GetTimeoutError, self._ray.exceptions.RayError):
                self._replace(k)
            else:
                return k

    def _least_loaded(self, *, wait: bool) -> int | None:
        """Return the index of the ready actor with the fewest attempts; None if none is ready and `wait` is False."""
        deadline = time.monotonic() + NO_ACTOR_TIMEOUT
        while True:
            problem = self._check_starting()
            ready = [k for k in range(len(self._actors)) if k not in self._starting]
            if ready:
                return min(ready, key=lambda k: self._load[k])
            if not wait:
                return None
            if time.monotonic() > deadline:
                raise NoWorkers(
                    f"No Ray actor came up within {NO_ACTOR_TIMEOUT:g} s ({problem or 'all wait for a core'}). What is "
                    "recorded stays. Check `ray status` for free cores, and that dynaforge is installed on every node."
                )
            self._ray.wait(list(self._starting.values()), num_returns=1, timeout=1.0)

    def _check_starting(self) -> str:
        """Note the actors that have become ready, and replace those that died; return why one did, or ""."""
        problem = ""
        for k, reference in list(self._starting.items()):
            if not self._ray.wait([reference], timeout=0)[0]:
                continue
            try:
                self._ray.get(reference)
                del self._starting[k]
            except self._ray.exceptions.RayError as error:
                problem = str(error).strip().splitlines()[-1]
                self._start(k)
                time.sleep(0.1)
        return problem


def connect_to_ray() -> Any:
    """Connect to a running Ray cluster and return the module ray.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
    """
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
