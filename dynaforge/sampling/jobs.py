"""Jobs that workers of any kind do: what such workers have in common."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sized
from typing import Protocol, TypeVar

Job = TypeVar("Job", contravariant=True)
Result = TypeVar("Result", covariant=True)


class Workers(Protocol[Job, Result]):
    """Workers of any kind, and the jobs that they were given, oldest first."""

    @property
    def running(self) -> Sized:
        """The jobs in progress."""

    def hand_out(self, source: Iterator[Job]) -> None:
        """Take as many jobs as keep all workers busy."""

    def next_result(self) -> Result:
        """Wait for the oldest job; a worker that died or hangs is replaced."""

    def kill(self) -> None:
        """End all workers."""


def in_order(workers: Workers[Job, Result], jobs: Iterable[Job]) -> Generator[Result, None, None]:
    """Do jobs and yield their results in order; the workers end with the iteration.

    Args:
        workers: What does the jobs.
        jobs: May be endless if the caller stops iterating.
    """
    source = iter(jobs)
    try:
        workers.hand_out(source)
        while workers.running:
            yield workers.next_result()
            workers.hand_out(source)
    finally:
        workers.kill()
