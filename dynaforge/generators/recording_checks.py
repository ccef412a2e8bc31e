"""Verification of a dataset's recordings in worker processes, one of which a recording may end or hang."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.folder_checks import Finding, Notes
from dynaforge.demos.observations import ObservationRenderer
from dynaforge.demos.replay import Replayer
from dynaforge.demos.verification import EpisodeVerifier
from dynaforge.generators.repeat import Repeater
from dynaforge.sampling.processes import started_pool
from dynaforge.tasks import Task

TIMEOUT = 300.0  # seconds of wall time after which a recording is taken to hang
WORTH_A_WORKER = {True: 4, False: 400}  # recordings, by whether they are simulated: a worker takes seconds to start


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyOptions:
    """What is checked.

    Attributes:
        folder: The dataset.
        task: Its task.
        notes: What lies beside its recordings.
        replay: Make every recorded attempt again and compare all that it records.
        audit: Look for what physics forbids.
        pictures: Render the observations again and compare them.
    """

    folder: Path
    task: Task
    notes: Notes
    replay: bool = False
    audit: bool = False
    pictures: bool = False

    def useful_workers(self, most: int) -> int:
        """Return how many processes are worth starting, up to `most`."""
        return min(most, -(-len(self.notes.names) // WORTH_A_WORKER[self.replay or self.pictures]))


def check_recordings(options: VerifyOptions, names: Sequence[str], *, workers: int = 1) -> Iterator[list[Finding]]:
    """Yield the findings of each recording, in order.

    A recording that ends or hangs the worker that checks it is a finding, and the others are still checked.

    Args:
        options: What is checked.
        names: Ids of the recordings.
        workers: Processes; 1 checks in this one.

    Raises:
        NoWorkers: Workers cannot even start.
    """
    if workers <= 1:
        with closing(RecordingChecker(options)) as checker:
            yield from map(checker.check, names)
        return
    file_of, left = DemonstrationDataset(options.folder).file_of, list(names)
    while left:
        done = yield from _in_pool(options, left, workers)
        # Which recording ended a worker is known only where a single worker checks them in turn.
        near, left = left[done : done + 2 * workers], left[done + 2 * workers :]
        while near:
            done = yield from _in_pool(options, near, 1)
            if done < len(near):
                yield [
                    Finding(file_of(near[done]), f"looking at it ends the process, or takes more than {TIMEOUT:g} s")
                ]
            near = near[done + 1 :]


def _in_pool(options: VerifyOptions, names: Sequence[str], workers: int) -> Generator[list[Finding], None, int]:
    """Yield findings until all are done or a worker dies or hangs; returns how many recordings were done."""
    done = 0
    with started_pool(workers, _start, options, timeout=TIMEOUT) as pool:
        try:
            for future in [pool.submit(_check, name) for name in names]:
                yield future.result(timeout=TIMEOUT)
                done += 1
        except (BrokenProcessPool, TimeoutError):
            pass
    return done


class RecordingChecker:
    """Checks one recording after another, opening what that needs once.

    Args:
        options: What is checked.
    """

    def __init__(self, options: VerifyOptions) -> None:
        self._stack = ExitStack()
        again = self._stack.enter_context(closing(Repeater(options.task))) if options.replay else None
        replayer = self._stack.enter_context(closing(Replayer(options.task))) if options.replay else None
        observations, renderer = options.notes.observations, None
        if options.pictures and observations is not None:
            renderer = self._stack.enter_context(closing(ObservationRenderer(options.task, observations.settings)))
        self.check = EpisodeVerifier(
            DemonstrationDataset(options.folder),
            options.notes,
            task=options.task,
            again=again,
            replayer=replayer,
            audited=options.audit,
            render=renderer.render if renderer else None,
        )

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._stack.close()


_checker: RecordingChecker | None = None  # of a worker process


def _start(options: VerifyOptions) -> None:
    global _checker
    _checker = RecordingChecker(options)


def _check(name: str) -> list[Finding]:
    assert _checker is not None
    return _checker.check(name)
