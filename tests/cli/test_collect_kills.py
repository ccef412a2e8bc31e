"""What a kill at any instant leaves behind: whole episodes, an honest ledger, and a collection that resumes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.verification import verify

COMMAND = (
    sys.executable,
    "-m",
    "dynaforge",
    "collect",
    "--task",
    "can",
    "--generator",
    "planner_only",
    "--keep-failures",
)


def start(folder: Path, attempts: int, *more: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*COMMAND, "--attempts", str(attempts), "--out", str(folder), *more],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


class Recording(NamedTuple):
    """A file as the system tells it from another, and what it holds."""

    file: tuple[int, int, int]
    content: str


def read_back(dataset: DemonstrationDataset, known: dict[str, Recording]) -> dict[str, Recording]:
    """Read every recording whose file is not the one that was read before."""
    found = {}
    for name in dataset.ids():
        stat = dataset.file_of(name).stat()
        file = (stat.st_ino, stat.st_mtime_ns, stat.st_size)
        same = name in known and known[name].file == file
        found[name] = known[name] if same else Recording(file, dataset[name].content_hash())
    return found


def wait_for_an_attempt(folder: Path, process: subprocess.Popen[bytes]) -> None:
    """Return once the ledger has grown."""
    ledger = folder / "ledger.jsonl"
    before = size(ledger)
    while size(ledger) == before:
        assert process.poll() is None, "the collector ended before it was killed"
        time.sleep(0.02)


def size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def killed_again_and_again(folder: Path, reference: Path, *, kills: int) -> None:
    """Kill collectors (all their processes) at random instants until it has been enough; then let one finish.

    Three of four die while they collect, the fourth wherever it is, starting up included. After each kill every
    recording must read back, and none that was finished before may have gone or changed.
    """
    rng = np.random.default_rng(0)
    finished: dict[str, Recording] = {}
    grew = 0
    for k in range(kills):
        process = start(folder, 100_000)
        try:
            if k % 4:
                wait_for_an_attempt(folder, process)
            time.sleep(rng.uniform(0.0, 2.0))
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        if not (folder / "dataset.json").is_file():
            continue
        stored = read_back(DemonstrationDataset(folder), finished)
        changed = [name for name in finished if name not in stored or stored[name].content != finished[name].content]
        assert not changed, "a finished episode was lost or changed"
        grew += len(stored) > len(finished)
        finished = stored
    attempts = len(DemonstrationDataset(folder).attempts()) + 10
    assert start(folder, attempts).wait() == 0
    assert start(reference, attempts).wait() == 0
    once = {episode.id: episode.content_hash() for episode in DemonstrationDataset(reference)}
    assert {e.id: e.content_hash() for e in DemonstrationDataset(folder)} == once, "the same as without any kill"
    ledgers = [{a.id: (a.success, a.failure) for a in DemonstrationDataset(f).attempts()} for f in (folder, reference)]
    assert ledgers[0] == ledgers[1]
    torn = [f for findings in verify(DemonstrationDataset(folder)) for f in findings if "was torn" not in f.problem]
    assert not torn
    assert grew > kills // 4


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_two_hundred_kills_lose_nothing(tmp_path: Path) -> None:
    killed_again_and_again(tmp_path / "killed", tmp_path / "whole", kills=200)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_collectors_share_a_folder(tmp_path: Path) -> None:
    """Both attempt the same conditions: what one has done the other may repeat, to the same bits."""
    both = [start(tmp_path / "shared", 60, "--workers", "1") for _ in range(2)]
    assert [process.wait() for process in both] == [0, 0]
    assert start(tmp_path / "whole", 60).wait() == 0
    shared, whole = (
        {e.id: e.content_hash() for e in DemonstrationDataset(tmp_path / name)} for name in ("shared", "whole")
    )
    assert whole.items() <= shared.items()
    assert not [f for findings in verify(DemonstrationDataset(tmp_path / "shared")) for f in findings]
