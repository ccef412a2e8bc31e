"""The same attempts on an existing Ray cluster: actors instead of worker processes, replaced when they die."""

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

NO_ACTOR_TIMEOUT = 300.0  # seconds without any actor that is up, after which the run ends
MAX_ACTOR_DEATHS = 2  # actors that die during an attempt before it counts as failed


class _AttemptActor:
    """The actor: an env of its own, attempt after attempt."""

    def __init__(self, task: Task, generator: Generator) -> None:
        self._env, self._generator = make_env(generator, task), generator

    def ready(self) -> None:
        """Return once it is up."""

    def attempt(self, condition: Condition) -> Result:
        return attempt_once(self._env, self._generator, condition)


def run_attempts_on_ray(
    task: Task, generator: Generator, conditions: Iterable[Condition], *, block: int = 0, workers: int | None = None
) -> Iterator[Result]:
    """Attempt every condition on a running Ray cluster and yield the results in order.

    What an actor that died was handed goes to those that are up, and another takes its place, as soon as the cluster
    has a core for it: work is keyed by condition, so repeating it is harmless. An attempt under which one actor after
    another falls is a failed attempt.

    Args:
        task: The task; dynaforge must be installed on every node.
        generator: What attempts.
        conditions: May be endless if the caller stops iterating.
        block: Block number noted with every attempt.
        workers: Actors, one core each; all cores of the cluster by default.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
        NoWorkers: No actor comes up.
    """
    ray = connected()
    count = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
    yield from in_order(_Actors(ray, task, generator, count), conditions, block=block)


@dataclass(slots=True, kw_only=True)
class _Attempt:
    """An attempt under way.

    Attributes:
        condition: At which.
        actor: By which; None while it waits for another.
        reference: Ray's, to its result.
        alone: Whether the actor had just shown that it is up and has nothing else to do.
        falls: How many actors have fallen under it while it was alone with them.
    """

    condition: Condition
    actor: int | None = None
    reference: Any = None
    alone: bool = False
    falls: int = 0


class _Actors:
    """Actors on a Ray cluster."""

    def __init__(self, ray: Any, task: Task, generator: Generator, size: int) -> None:
        self.running: deque[_Attempt] = deque()
        self._ray, self._name = ray, generator.name
        inherited = SINGLE_THREAD | {VARIABLE: os.environ.get(VARIABLE, "")}  # a task of one's own needs its module
        make = ray.remote(num_cpus=1, max_restarts=0, runtime_env={"env_vars": inherited})(_AttemptActor)
        self._make: Callable[[], Any] = lambda: make.remote(task, generator)
        self._actors: list[Any] = [None] * size
        self._starting: dict[int, Any] = {}
        self._load = [0] * size
        for k in range(size):
            self._start(k)

    def hand_out(self, source: Iterator[Condition]) -> None:
        """Give every actor that is up as much as it may have; wait for one if none is."""
        while (k := self._freest(wait=not self.running)) is not None and self._load[k] < ATTEMPTS_PER_WORKER:
            condition = next(source, None)
            if condition is None:
                return
            self.running.append(_Attempt(condition=condition))
            self._give(self.running[-1], k)

    def next_result(self) -> Result:
        """Wait for the oldest attempt.

        An actor's fall is held against an attempt only if it was alone with an actor that was up: a node takes many
        actors down at once, and another attempt may have been the cause.
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
                attempt.falls += attempt.alone
                self._replace(attempt.actor)
                if attempt.falls < MAX_ACTOR_DEATHS:
                    self._give(attempt, self._idle_one(), alone=True)
                    self._give_again()
                    continue
                result = failed_attempt(attempt.condition, self._name, f"worker lost: {type(error).__name__}")
            self.running.popleft()
            self._give_again()
            return result

    def kill(self) -> None:
        for actor in self._actors:
            self._ray.kill(actor)

    def _start(self, k: int) -> None:
        self._actors[k], self._load[k] = self._make(), 0
        self._starting[k] = self._actors[k].ready.remote()

    def _give(self, attempt: _Attempt, k: int, *, alone: bool = False) -> None:
        self._load[k] += 1
        attempt.actor, attempt.alone, attempt.reference = k, alone, self._actors[k].attempt.remote(attempt.condition)

    def _give_again(self) -> None:
        """Give what fallen actors had to those that are up."""
        for attempt in self.running:
            if attempt.actor is None:
                k = self._freest(wait=True)
                assert k is not None
                self._give(attempt, k)

    def _replace(self, k: int) -> None:
        """Put another actor in the place of one that fell or hangs; what it had waits."""
        self._ray.kill(self._actors[k])
        self._start(k)
        for attempt in self.running:
            if attempt.actor == k:
                attempt.actor = None

    def _idle_one(self) -> int:
        """Wait until an actor shows that it is up and through with all it was given."""
        while True:
            k = self._freest(wait=True)
            assert k is not None
            try:
                self._ray.get(self._actors[k].ready.remote(), timeout=TIMEOUT)
            except (self._ray.exceptions.GetTimeoutError, self._ray.exceptions.RayError):
                self._replace(k)
            else:
                return k

    def _freest(self, *, wait: bool) -> int | None:
        """Return the actor with the least to do among those that are up."""
        deadline = time.monotonic() + NO_ACTOR_TIMEOUT
        while True:
            problem = self._greet()
            up = [k for k in range(len(self._actors)) if k not in self._starting]
            if up:
                return min(up, key=lambda k: self._load[k])
            if not wait:
                return None
            if time.monotonic() > deadline:
                raise NoWorkers(
                    f"No Ray actor came up within {NO_ACTOR_TIMEOUT:g} s ({problem or 'all wait for a core'}). What is "
                    "recorded stays. See `ray status` for free cores, and that dynaforge is installed on every node."
                )
            self._ray.wait(list(self._starting.values()), num_returns=1, timeout=1.0)

    def _greet(self) -> str:
        """Find out who has come up, and replace who fell on the way; returns why, if any did."""
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


def connected() -> Any:
    """Return the module ray, connected to a running cluster.

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
