"""Jobs on an existing Ray cluster, with actors instead of worker processes, for the `--engine ray` of every command."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, TypeVar

from dynaforge.registration import TASK_FILES_VARIABLE
from dynaforge.sampling.processes import SINGLE_THREAD, NoWorkers
from dynaforge.sampling.ray_cluster import cluster_cores, connect_to_ray

NO_ACTOR_TIMEOUT = 300.0  # seconds without any ready actor after which the jobs end
MAX_ACTOR_DEATHS = 3  # actors that die during a job before it counts as failed
LONGEST_WAIT = 1.0  # seconds between two looks at jobs that may hang
ANSWER_TIMEOUT = 2.0  # seconds that a worker may take for an answer

Job = TypeVar("Job")
Result = TypeVar("Result")


class _Actor:
    """Makes a worker and does jobs with it, one after the other."""

    def __init__(self, make_worker: Callable[[], Callable[[Any], Any]]) -> None:
        self._worker = make_worker()

    def ready(self) -> None:
        """Return once all that was asked for before is done."""

    def do(self, job: Any) -> Any:
        return self._worker(job)

    def ask(self, method: str) -> Any:
        return getattr(self._worker, method)()


@dataclass(slots=True, eq=False)
class _HandedOut(Generic[Job]):
    """A job that was handed out.

    Attributes:
        job: The job.
        actor: Index of its actor; None while it waits for one.
        begun: Ray's reference to the sign that the actor has come to this job.
        reference: Ray's reference to the result.
        since: When the actor had nothing else to do first.
        deaths: Number of actors that died during it.
        done: Whether there is a result.
        result: The result.
    """

    job: Job
    actor: int | None = None
    begun: Any = None
    reference: Any = None
    since: float = 0.0
    deaths: int = 0
    done: bool = False
    result: Any = None


class RayJobs(Generic[Job, Result]):
    """Jobs on actors of a running Ray cluster, one core each; the `Workers` of `in_order`.

    When an actor dies, its jobs go to the others, and a new actor takes its place as soon as the cluster has a core for
    it. The result of a job must therefore depend on the job only: doing it again is harmless. A job during which one
    actor after another dies has failed.

    Args:
        make_worker: Makes what does the jobs, once in each actor; dynaforge must be installed on every node.
        failed: Returns the result of a job that cannot be done, from the job and the reason.
        size: Number of actors; by default one per core of the cluster.
        queued: Jobs that an actor is given at a time; with two it never waits for the next.
        timeout: Seconds after which a job counts as hanging.
        answering: Whether the workers can be asked something during a job, see `ask`.

    Attributes:
        running: The jobs whose results have not been taken, oldest first.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
    """

    def __init__(
        self,
        make_worker: Callable[[], Callable[[Job], Result]],
        *,
        failed: Callable[[Job, str], Result],
        size: int | None = None,
        queued: int = 2,
        timeout: float = math.inf,
        answering: bool = False,
    ) -> None:
        self._ray = connect_to_ray()
        size = size or cluster_cores()
        self.running: list[_HandedOut[Job]] = []
        self._failed, self._queued, self._timeout = failed, queued, timeout
        inherited = SINGLE_THREAD | {TASK_FILES_VARIABLE: os.environ.get(TASK_FILES_VARIABLE, "")}
        options = {"num_cpus": 1, "max_restarts": 0, "max_concurrency": 1 + answering}
        make = self._ray.remote(runtime_env={"env_vars": inherited}, **options)(_Actor)
        self._make: Callable[[], Any] = lambda: make.remote(make_worker)
        self._actors: list[Any] = [None] * size
        self._queues: list[deque[_HandedOut[Job]]] = [deque() for _ in range(size)]
        self._starting: dict[int, Any] = {}
        self._last_ready = time.monotonic()
        for k in range(size):
            self._start(k)

    def hand_out(self, source: Iterator[Job]) -> None:
        """Take as many jobs as the ready actors may have; one if none is ready."""
        ready = len(self._actors) - len(self._starting)
        room = self._queued * ready if ready else 1
        self.running += map(_HandedOut, islice(source, max(0, room - len(self.running))))
        self._assign()

    def next_result(self) -> Result:
        """Wait for the oldest job.

        Raises:
            NoWorkers: No actor becomes ready.
        """
        while not self.running[0].done:
            self.wait(LONGEST_WAIT)
        result: Result = self.running.pop(0).result
        return result

    def finished(self) -> list[Result]:
        """Take the results that there are, oldest first."""
        results: list[Result] = [job.result for job in self.running if job.done]
        self.running = [job for job in self.running if not job.done]
        return results

    def wait(self, seconds: float) -> None:
        """Wait until a job is done or an actor is ready, but not longer than this.

        Raises:
            NoWorkers: No actor has been ready for a long time.
            Exception: What a worker raised.
        """
        self._check_starting()
        self._assign()
        awaited = [queue[0].reference for queue in self._queues if queue] + list(self._starting.values())
        if awaited:
            self._ray.wait(awaited, num_returns=1, timeout=seconds)
        self._check_jobs()

    def ask(self, method: str) -> list[tuple[Job, Any]]:
        """Call a method of every worker that is at a job; return these jobs with the answers that come soon.

        Args:
            method: Name of the method; it takes no arguments and runs in another thread than the job.
        """
        asked = {self._actors[k].ask.remote(method): queue[0].job for k, queue in enumerate(self._queues) if queue}
        answered = self._done(asked, seconds=ANSWER_TIMEOUT)
        return [(asked[reference], self._ray.get(reference)) for reference in answered if self._succeeded(reference)]

    def kill(self) -> None:
        """End all actors."""
        for actor in self._actors:
            self._ray.kill(actor)

    def _start(self, k: int) -> None:
        self._actors[k] = self._make()
        self._starting[k] = self._actors[k].ready.remote()

    def _replace(self, k: int) -> None:
        """Replace an actor that died or hangs; its jobs wait for another."""
        self._ray.kill(self._actors[k])
        for job in self._queues[k]:
            job.actor = None
        self._queues[k].clear()
        self._start(k)

    def _assign(self) -> None:
        """Give the jobs that wait to the ready actors with the fewest."""
        for job in self.running:
            if job.actor is not None or job.done:
                continue
            ready = [k for k in range(len(self._actors)) if k not in self._starting]
            k = min(ready, key=lambda k: len(self._queues[k]), default=None)
            if k is None or len(self._queues[k]) >= self._queued:
                return
            job.actor, job.since = k, time.monotonic()
            job.begun, job.reference = self._actors[k].ready.remote(), self._actors[k].do.remote(job.job)
            self._queues[k].append(job)

    def _check_jobs(self) -> None:
        """Note the jobs that are done, and replace the actors that died or hang."""
        first = {queue[0].reference: queue[0] for queue in self._queues if queue}
        for reference in self._done(first):
            self._note_done(first[reference])
        for queue in self._queues:
            if queue and time.monotonic() - queue[0].since > self._timeout:
                self._give_up(queue[0], f"it ran for {self._timeout:g} s")

    def _note_done(self, job: _HandedOut[Job]) -> None:
        assert job.actor is not None
        try:
            job.result, job.done = self._ray.get(job.reference), True
        except self._ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except self._ray.exceptions.RayError as error:
            # A node that fails takes idle actors down too: their deaths must not count against the next jobs.
            job.deaths += bool(self._done([job.begun])) and self._succeeded(job.begun)
            if job.deaths >= MAX_ACTOR_DEATHS:
                self._give_up(job, type(error).__name__)
            else:
                self._replace(job.actor)
            return
        queue = self._queues[job.actor]
        queue.popleft()
        if queue:
            queue[0].since = time.monotonic()

    def _give_up(self, job: _HandedOut[Job], problem: str) -> None:
        assert job.actor is not None
        self._replace(job.actor)
        job.result, job.done = self._failed(job.job, f"worker lost: {problem}"), True

    def _check_starting(self) -> None:
        """Note the actors that have become ready, and replace those that died."""
        problem = ""
        starting = {reference: k for k, reference in self._starting.items()}
        for reference in self._done(starting):
            k = starting[reference]
            try:
                self._ray.get(reference)
                del self._starting[k]
            except self._ray.exceptions.RayError as error:
                problem = str(error).strip().splitlines()[-1]
                self._start(k)
                time.sleep(0.1)
        if len(self._starting) < len(self._actors):
            self._last_ready = time.monotonic()
        elif time.monotonic() > self._last_ready + NO_ACTOR_TIMEOUT:
            raise NoWorkers(
                f"No Ray actor came up within {NO_ACTOR_TIMEOUT:g} s ({problem or 'all wait for a core'}). What is "
                "recorded stays. Check `ray status` for free cores, and that dynaforge is installed on every node."
            )

    def _done(self, references: Iterable[Any], *, seconds: float = 0.0) -> list[Any]:
        """Return the references that have a result or an error by now, or within a time."""
        listed = list(references)
        return list(self._ray.wait(listed, num_returns=len(listed), timeout=seconds)[0]) if listed else []

    def _succeeded(self, reference: Any) -> bool:
        try:
            self._ray.get(reference)
        except self._ray.exceptions.RayError:
            return False
        return True
