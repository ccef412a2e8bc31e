from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from dynaforge.demos.episode_file import read_episode
from dynaforge.files.atomic import atomic_write, check_writable, is_temporary, remove_stale

DIE_AT = """
import os, signal, sys
from dynaforge.files.atomic import atomic_write
def die(*_): os.kill(os.getpid(), signal.SIGKILL)
for stage in ("write", "fsync", "replace"):
    if os.fork() == 0:
        if stage == "write":
            whole = os.write
            os.write = lambda fd, data: (whole(fd, data[:10]), die())
        else:
            setattr(os, stage, die)
        atomic_write(os.path.join(sys.argv[1], stage), b"new" * 100)
        os._exit(0)
    assert os.WIFSIGNALED(os.wait()[1])
"""

WRITE_ON = """
import itertools, sys
import numpy as np
from dynaforge.demos import DemonstrationDataset, Episode
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome
data = DemonstrationDataset(sys.argv[1], task="can")
for seed in itertools.count():
    condition = Condition("can", seed, 0.4, {})
    data.add(Episode(condition=condition, generator="planner", outcome=Outcome(success=True, checkpoint=4),
                     duration=1.0, steps={"time": np.arange(5000.0)}))
    print(condition.id, flush=True)
"""


def test_kill_at_any_stage_leaves_the_old_file(tmp_path):
    for stage in ("write", "fsync", "replace"):
        (tmp_path / stage).write_bytes(b"old")
    subprocess.run([sys.executable, "-c", DIE_AT, str(tmp_path)], check=True, timeout=60)
    leftovers = [path for path in tmp_path.iterdir() if is_temporary(path)]
    assert len(leftovers) == 3
    assert [(tmp_path / stage).read_bytes() for stage in ("write", "fsync", "replace")] == [b"old"] * 3
    assert remove_stale(tmp_path) == 0  # a process may still be writing them
    assert remove_stale(tmp_path, older_than=-1.0) == 3


def test_killed_collector_loses_no_finished_episode(tmp_path):
    from dynaforge.demos import DemonstrationDataset

    command = [sys.executable, "-c", WRITE_ON, str(tmp_path / "d")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        finished = [child.stdout.readline().strip() for _ in range(5)]
        time.sleep(0.0137)
        os.kill(child.pid, signal.SIGKILL)
        finished += child.stdout.read().split()
    data = DemonstrationDataset(tmp_path / "d", task="can")
    assert {f"{one}-planner" for one in finished if len(one) == 16} <= set(data.ids())
    assert all(len(episode) == 5000 for episode in data)
    assert {attempt.id for attempt in data.ledger.attempts()} == set(data.ids())


def test_writer_gets_the_final_suffix_and_failure_leaves_nothing(tmp_path):
    def torn(path):
        assert path.suffix == ".zip"
        path.write_bytes(b"half")
        raise OSError("disk full")

    (tmp_path / "model.zip").write_bytes(b"old")
    with pytest.raises(OSError, match="disk full"):
        atomic_write(tmp_path / "model.zip", torn)
    assert [path.name for path in tmp_path.iterdir()] == ["model.zip"]
    assert (tmp_path / "model.zip").read_bytes() == b"old"
    atomic_write(tmp_path / "model.zip", lambda path: path.write_bytes(b"new") and None)
    assert (tmp_path / "model.zip").read_bytes() == b"new"


def test_new_file_keeps_the_umask(tmp_path):
    old = os.umask(0o022)
    try:
        atomic_write(tmp_path / "shared", b"x")
    finally:
        os.umask(old)
    assert (tmp_path / "shared").stat().st_mode & 0o777 == 0o644


def test_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(PermissionError, match="file: Not a directory"):
        check_writable(tmp_path / "file")


def test_missing_episode_is_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_episode(tmp_path / "none.h5")
