"""`dynaforge verify`: is every byte, value, outcome and, with --replay, every attempt as it was recorded?"""

from __future__ import annotations

import argparse
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.observations import ObservationRenderer
from dynaforge.demos.replay import Replayer
from dynaforge.demos.verification import EpisodeVerifier, Finding, Notes, read_notes, verify_folder
from dynaforge.generators.repeat import Repeater
from dynaforge.sampling.processes import guard_hint, kill_pool, worker_pool
from dynaforge.tasks import Task

WORTH_A_WORKER = {True: 4, False: 400}  # recordings, by whether they are simulated: a worker takes seconds to start
TIMEOUT = 300.0  # seconds of wall time after which a recording is taken to hang


@dataclass(frozen=True, slots=True)
class Asked:
    """What is to be checked.

    Attributes:
        folder, task: The dataset.
        notes: What lies beside its recordings.
        replay, audit, pictures: The options.
    """

    folder: Path
    task: Task
    notes: Notes
    replay: bool
    audit: bool
    pictures: bool = False


def run(options: argparse.Namespace) -> int:
    """Check and print every finding; returns 1 when there is any."""
    dataset, task = open_dataset(options)
    notes, found = read_notes(dataset), 0
    asked = Asked(options.folder, task, notes, options.replay, options.audit, options.pictures)
    simulated = options.replay or options.pictures
    workers = min(options.workers, -(-len(notes.names) // WORTH_A_WORKER[simulated]))
    checked = chain([verify_folder(dataset, notes, task)], check(asked, notes.names, workers))
    for findings in tqdm(checked, total=len(notes.names) + 1, leave=False, unit="file"):
        for finding in findings:
            tqdm.write(str(finding))
        found += len(findings)
    how = "read and made again" if options.replay else "read"
    print(f"{len(notes.names)} episodes {how}, {len(notes.attempts)} attempts in the ledger: {found or 'no'} problems")
    return 1 if found else 0


def check(asked: Asked, names: Sequence[str], workers: int) -> Iterator[list[Finding]]:
    """Yield the findings of one recording after the other, in order, made on so many cores.

    A recording that ends or hangs the worker that looks at it is a finding, and the rest goes on.

    Raises:
        OSError: Workers cannot even start.
    """
    if workers <= 1:
        with closing(Checker(asked)) as checker:
            yield from map(checker.check, names)
        return
    file_of, left = DemonstrationDataset(asked.folder).file_of, list(names)
    while left:
        done = yield from _in_pool(asked, left, workers)
        # Which recording ended a worker is known only where one worker looks at them in turn.
        near, left = left[done : done + 2 * workers], left[done + 2 * workers :]
        while near:
            done = yield from _in_pool(asked, near, 1)
            if done < len(near):
                yield [
                    Finding(file_of(near[done]), f"looking at it ends the process, or takes more than {TIMEOUT:g} s")
                ]
            near = near[done + 1 :]


def _in_pool(asked: Asked, names: Sequence[str], workers: int) -> Generator[list[Finding], None, int]:
    """Yield findings until all are done or a worker dies or hangs; returns how many were done."""
    pool, done = worker_pool(workers, _start, asked), 0
    try:
        pool.submit(_ready).result(timeout=TIMEOUT)
    except (BrokenProcessPool, TimeoutError) as error:
        kill_pool(pool)
        raise OSError(f"Worker processes die as they start.{guard_hint()}") from error
    try:
        for future in [pool.submit(_check, name) for name in names]:
            yield future.result(timeout=TIMEOUT)
            done += 1
    except (BrokenProcessPool, TimeoutError):
        pass
    finally:
        kill_pool(pool)
    return done


class Checker:
    """Checks one recording after another, opening what that needs once.

    Args:
        asked: What is to be checked.
    """

    def __init__(self, asked: Asked) -> None:
        self._stack = ExitStack()
        again = self._stack.enter_context(closing(Repeater(asked.task))) if asked.replay else None
        replayer = self._stack.enter_context(closing(Replayer(asked.task))) if asked.replay else None
        seen, renderer = asked.notes.observations, None
        if asked.pictures and seen is not None:
            renderer = self._stack.enter_context(closing(ObservationRenderer(asked.task, seen.settings)))
        self.check = EpisodeVerifier(
            DemonstrationDataset(asked.folder), asked.notes, task=asked.task, again=again, replayer=replayer,
            audited=asked.audit, render=renderer.render if renderer else None,
        )  # fmt: skip

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._stack.close()


_checker: Checker | None = None


def _start(asked: Asked) -> None:
    global _checker
    _checker = Checker(asked)


def _ready() -> None:
    """Do nothing: a worker that can has started."""


def _check(name: str) -> list[Finding]:
    assert _checker is not None
    return _checker.check(name)
