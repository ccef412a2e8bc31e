"""Verification of recordings in worker processes, since a damaged recording may crash or hang a process."""

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

TIMEOUT = 300.0  # seconds of wall time after which a check counts as hanging
RECORDINGS_PER_WORKER = {True: 4, False: 400}  # at least, by whether they are simulated: a worker starts in seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyOptions:
    """What is checked.

    Attributes:
        folder: Folder of the dataset.
        task: Its task.
        notes: What the folder contains besides the recordings.
        replay: Whether to make every recorded attempt again and compare the recordings.
        audit: Whether to look for motion that physics forbids.
        pictures: Whether to render the observations again and compare them.
    """

    folder: Path
    task: Task
    notes: Notes
    replay: bool = False
    audit: bool = False
    pictures: bool = False

    def useful_workers(self, most: int) -> int:
        """Return how many processes are worth starting, `most` at most."""
        return min(most, -(-len(self.notes.names) // RECORDINGS_PER_WORKER[self.replay or self.pictures]))


def check_recordings(options: VerifyOptions, names: Sequence[str], *, workers: int = 1) -> Iterator[list[Finding]]:
    """Yield the findings of each recording, in order.

    A recording that crashes or hangs its worker is a finding, and the others are still checked.

    Args:
        options: What is checked.
        names: Ids of the recordings.
        workers: Number of processes; with 1, this process checks them.

    Raises:
        NoWorkers: Workers cannot start.
    """
    if workers <= 1:
        with closing(RecordingChecker(options)) as checker:
            yield from map(checker.check, names)
        return
    file_of, remaining = DemonstrationDataset(options.folder).file_of, list(names)
    problem = f"checking it ends the process, or takes more than {TIMEOUT:g} s"
    while remaining:
        done = yield from _check_in_pool(options, remaining, workers)
        # A single worker, which checks one recording at a time, shows which of the next ones ended a worker.
        suspects, remaining = remaining[done : done + 2 * workers], remaining[done + 2 * workers :]
        while suspects:
            done = yield from _check_in_pool(options, suspects, 1)
            if done < len(suspects):
                yield [Finding(file_of(suspects[done]), problem)]
            suspects = suspects[done + 1 :]


def _check_in_pool(options: VerifyOptions, names: Sequence[str], workers: int) -> Generator[list[Finding], None, int]:
    """Yield findings until all are done or a worker dies or hangs; return how many recordings were done."""
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
    """Checks one recording after another; what this needs is opened once.

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


_checker: RecordingChecker | None = None  # the state of a worker process


def _start(options: VerifyOptions) -> None:
    global _checker
    _checker = RecordingChecker(options)


def _check(name: str) -> list[Finding]:
    assert _checker is not None
    return _checker.check(name)
