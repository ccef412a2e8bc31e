"""Workers: how many, how they start, and that they end."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dynaforge.sampling import processes
from dynaforge.sampling.processes import NoWorkers, affordable_workers, started_pool, usable_cores, worker_pool

SCRIPT = """
import os, time
from dynaforge.sampling.processes import worker_pool

class Mine:
    def begin(self): os.environ["BEGUN"] = "yes"

if __name__ == "__main__":
    pool = worker_pool(1, Mine().begin)
    print(pool.submit(os.getpid).result(), pool.submit(os.getenv, "BEGUN").result(), flush=True)
    pool.submit(time.sleep, 600).result()
"""


QUOTA = {"quota": "300000", "period": "100000"}


def gone_within(pids: list[int], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while any(Path(f"/proc/{pid}/exe").exists() for pid in pids):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def write(root: Path, name: str, text: str) -> None:
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text(text)


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stands for a machine of 64 cores, of which the affinity leaves 16."""
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(16)), raising=False)
    return tmp_path


def test_the_cores_are_those_of_the_affinity(machine: Path) -> None:
    assert usable_cores(machine) == 16


@pytest.mark.parametrize(
    ("groups", "limits", "cores"),
    [
        ("0::/", {"cpu.max": "max 100000"}, 16),
        ("0::/", {"cpu.max": "400000 100000"}, 4),
        ("0::/", {"cpu.max": "150000 100000"}, 2),
        ("0::/", {"cpu.max": "20000 100000"}, 1),
        ("0::/", {"cpu.max": "9900000 100000"}, 16),
        ("0::/jobs/7", {"jobs/cpu.max": "300000 100000", "jobs/7/cpu.max": "max 100000"}, 3),
        ("0::/seen/from/outside", {"cpu.max": "200000 100000"}, 2),
        ("4:cpu,cpuacct:/a", {f"cpu,cpuacct/a/cpu.cfs_{name}_us": text for name, text in QUOTA.items()}, 3),
        ("4:cpu:/", {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, 16),
        ("3:cpuset:/\n2:cpu:/docker/ab\n0::/", {"cpu/cpu.cfs_quota_us": "50000", "cpu/cpu.cfs_period_us": "25000"}, 2),
        ("0::/", {"cpu.max": "nonsense"}, 16),
    ],
)
def test_a_quota_of_the_cgroup_counts(groups: str, limits: dict[str, str], cores: int, machine: Path) -> None:
    write(machine, "proc/self/cgroup", groups + "\n")
    for name, text in limits.items():
        write(machine, f"sys/fs/cgroup/{name}", text + "\n")
    assert usable_cores(machine) == cores


def test_no_module_counts_the_cores_of_the_machine() -> None:
    package = Path(processes.__file__).parents[1]
    counting = [path.name for path in package.rglob("*.py") if "cpu_count" in path.read_text()]
    assert counting == ["processes.py"]


@pytest.fixture
def parent(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a script with a worker, in a folder whose files are named as modules of the standard library."""
    here = tmp_path / "here"
    for name in ("json", "numpy", "signal", "random"):
        write(here, f"{name}.py", "raise RuntimeError('imported from the current folder')")
    write(tmp_path, "script.py", SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py")]
    with subprocess.Popen(command, cwd=here, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


def test_workers_ignore_the_current_folder_and_end_with_a_killed_parent(parent: subprocess.Popen[str]) -> None:
    pid, begun = parent.stdout.readline().split()
    assert begun == "yes", "what the main script defines travels by value"
    os.kill(int(pid), 0)
    parent.kill()
    assert gone_within([int(pid)], 10.0)


def test_a_process_ends_with_the_pipe_it_was_given() -> None:
    code = "import time; from dynaforge.sampling.processes import end_after; end_after(0); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE) as child:
        child.stdin.close()
        assert child.wait(timeout=30) == 1


def test_missing_shared_memory_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: Any, **kwargs: Any) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(processes, "worker_context", lambda: None)
    monkeypatch.setattr(processes, "ProcessPoolExecutor", refuse)
    with pytest.raises(OSError, match=r"/dev/shm refuses them: Read-only file system.*--shm-size"):
        worker_pool(1, print)


@pytest.mark.parametrize(
    ("start", "argument", "timeout", "message"),
    [
        (os._exit, 3, 60.0, "Worker processes die as they start"),
        (time.sleep, 60, 0.5, r"have not started within 0\.5 s"),
    ],
)
def test_workers_that_do_not_start_are_an_error_and_are_ended(
    start: Any, argument: int, timeout: float, message: str
) -> None:
    before = set(multiprocessing.active_children())
    with pytest.raises(NoWorkers, match=message), started_pool(1, start, argument, timeout=timeout):
        pytest.fail("no worker has started")
    assert set(multiprocessing.active_children()) <= before


@pytest.mark.slow
def test_code_on_stdin_may_use_workers() -> None:
    code = SCRIPT.replace('if __name__ == "__main__":', "if True:").replace("600", "0")
    done = subprocess.run([sys.executable, "-"], input=code, capture_output=True, text=True, timeout=100, check=True)
    assert done.stdout.split()[1] == "yes"


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "command", ["compare --algos ppo --train-seeds 1", "collect --attempts 1000", "evaluate --generator planner_only"]
)
def test_a_killed_command_leaves_no_child(command: str, tmp_path: Path) -> None:
    name, *flags = command.split()
    line = [
        sys.executable,
        "-m",
        "dynaforge",
        name,
        "--task",
        "can",
        *flags,
        "--workers",
        "2",
        "--out",
        str(tmp_path / "out"),
    ]
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as parent:
        below: list[int] = []
        deadline = time.monotonic() + 60.0
        while len(below) < 2 and time.monotonic() < deadline:
            time.sleep(0.2)
            below = descendants(parent.pid)
        time.sleep(8.0)
        below = descendants(parent.pid)
        assert len(below) >= 2
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    assert gone_within(below, 10.0)


def descendants(pid: int) -> list[int]:
    try:
        children = [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
    return [*children, *(below for child in children for below in descendants(child))]


def test_closed_standard_descriptors_are_no_place_for_pipes(tmp_path: Path) -> None:
    code = """
import os, sys
from dynaforge.cli.terminal import show_anything
show_anything()
print("to nobody", file=sys.stderr)
open(sys.argv[1], "w").write(f"{os.pipe()} {[os.get_inheritable(k) for k in range(3)]}")
"""
    mark = tmp_path / "mark"
    shell = ["sh", "-c", '"$0" -c "$1" "$2" <&- >&- 2>&-', sys.executable, code, str(mark)]
    subprocess.run(shell, check=True, timeout=60)
    assert mark.read_text().endswith(" [True, True, True]")
    assert not {"(0", "(1", "(2"} & {mark.read_text().partition(",")[0]}


def test_few_open_files_make_fewer_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    resource = pytest.importorskip("resource")
    for limit, most in ((64, 16), (256, 112), (20, 1)):
        monkeypatch.setattr(resource, "getrlimit", lambda _, limit=limit: (limit, limit))
        assert affordable_workers() == most
