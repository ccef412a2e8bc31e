"""Collecting onto a disk that is full, and into folders that are none."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.verification import verify


def test_a_full_disk_costs_nothing_that_was_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "data"
    command = ["collect", "--generator", "planner_only", "--attempts", "4", "--keep-failures", "--workers", "1"]
    room, write = 150_000, os.write

    def until_full(descriptor: int, data: bytes) -> int:
        nonlocal room
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):  # the terminal, or a pipe to a worker
            return write(descriptor, data)
        if room < len(data):
            raise OSError(errno.ENOSPC, "No space left on device")
        room -= len(data)
        return write(descriptor, data)

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", until_full)
        assert main([*command, "--out", str(folder)]) == 2
    said = capsys.readouterr().err
    assert f"No space left on device: '{folder}" in said
    assert "make room, then run the same command again" in said
    dataset = DemonstrationDataset(folder)
    assert 0 < len(dataset) < 4
    problems = [finding.problem for findings in verify(dataset) for finding in findings]
    assert len(problems) <= 1  # the disk may be full after a recording and before its line
    assert all("there is no line for" in problem and "`collect` adds it" in problem for problem in problems)
    recorded = {episode.id: episode.content_hash() for episode in dataset}
    assert main([*command, "--out", str(folder)]) == 0
    after = {episode.id: episode.content_hash() for episode in DemonstrationDataset(folder)}
    assert recorded.items() <= after.items()
    assert len(after) == 4


def test_a_folder_that_cannot_be_is_named_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_bytes(b"")
    assert main(["collect", "--generator", "planner_only", "--out", str(tmp_path / "file" / "below")]) == 2
    assert str(tmp_path / "file") in capsys.readouterr().err


def test_sigterm_ends_as_ctrl_c_does(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "dynaforge", "collect", "--generator", "planner_only", "--attempts", "5000"]
    process = subprocess.Popen(
        [*command, "--workers", "1", "--out", str(tmp_path / "data")],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    ledger = tmp_path / "data" / "ledger.jsonl"
    deadline = time.monotonic() + 60
    while not (ledger.is_file() and ledger.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.terminate()
    said, _ = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "the same command resumes" in said
    deadline = time.monotonic() + 10
    while _alive(process.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _alive(process.pid), "no worker is left behind"


def _alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
