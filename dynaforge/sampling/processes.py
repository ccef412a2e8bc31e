"""How worker processes start, how many there are, and how they end: never forked, one thread each, never orphaned.

Light to import: nothing of the package, and nothing beyond the standard library.
"""

from __future__ import annotations

import contextlib
import errno
import math
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection, forkserver, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

SINGLE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
# Python's switch for a sys.path without the current folder, where a json.py or numpy.py may be. Any value switches it
# on; this one distinguishes our setting from a user's.
SAFE_PATH, SET_BY_US = "PYTHONSAFEPATH", "dynaforge"
PARENT_GONE_GRACE = 1.0  # s
OPEN_FILES = 32  # needed by the pool, the libraries and the files being written, besides the workers' own
NO_SHARED_MEMORY = (errno.EROFS, errno.EACCES, errno.EPERM, errno.ENOENT, errno.ENOSPC, errno.ENOSYS)
GUARD = "if __name__ == '__main__':"


class NoWorkers(RuntimeError):  # noqa: N818  the name says what happened
    """Workers do not even start."""


def usable_cores(root: Path = Path("/")) -> int:
    """Count the cores that this process may use: by its affinity, and by the CPU quota of its cgroup.

    On a shared node, in a container or a batch job these are fewer than the machine has.

    Args:
        root: Where `proc` and `sys` are found.
    """
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS
        cores = os.cpu_count() or 1
    return max(1, min([cores, *(math.ceil(quota) for quota in _quotas(root))]))


def _quotas(root: Path) -> Iterator[float]:
    """Yield the quotas, in cores, of this process's cgroups and of all above them: v2's, then v1's."""
    base = root / "sys" / "fs" / "cgroup"
    try:
        lines = (root / "proc" / "self" / "cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            mounts, names = [base, base / "unified"], ["cpu.max"]
        elif "cpu" in controllers.split(","):
            mounts, names = [base / controllers, base / "cpu"], ["cpu.cfs_quota_us", "cpu.cfs_period_us"]
        else:
            continue
        place = Path(path.lstrip("/"))
        for folder in (mount / part for mount in mounts for part in (place, *place.parents)):
            with contextlib.suppress(OSError, ValueError):  # no such folder, or no limit: "max", or -1
                quota, period = (int(word) for name in names for word in (folder / name).read_text().split())
                if quota > 0 and period > 0:
                    yield quota / period


def worker_context() -> Any:
    """Return the multiprocessing context of all workers.

    Never fork: locks held by the parent's threads (torch, BLAS) would stay locked in the child. The fork server imports
    the envs once and every worker starts from there.

    Raises:
        SystemExit: This is a worker importing a main script that starts workers without its guard. The parent reports
            that; a message from every worker would hide it.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise SystemExit(1)
    fill_standard_descriptors()
    main = sys.modules["__main__"]
    if getattr(main, "__file__", None) == "<stdin>":  # Python's name for `python -`; workers would look for that file
        del main.__file__
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if "forkserver" in methods:
        context.set_forkserver_preload(["dynaforge.envs.residual_env", "dynaforge.sampling.vector_worker"])
        with worker_environment():
            forkserver.ensure_running()
    return context


def fill_standard_descriptors() -> None:
    """Open the null device where stdin, stdout or stderr is closed, as it is for services and daemons.

    Otherwise the next files and pipes take these numbers, and C code that prints, in a worker too, writes into them.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest number that is free: this one


def guard_hint() -> str:
    """Return the likely reason why workers die as they start; empty where there is no script that they could import."""
    if getattr(sys.modules["__main__"], "__file__", None) is None:
        return ""
    return f" A script that starts workers needs `{GUARD}` around what it runs, since workers import it."


@contextlib.contextmanager
def worker_environment() -> Iterator[None]:
    """Let processes started in the block inherit one thread per numerical library, and a safe path for imports."""
    inherited = SINGLE_THREAD | {SAFE_PATH: os.environ.get(SAFE_PATH) or SET_BY_US}
    before = {name: os.environ.get(name) for name in inherited}
    os.environ.update(inherited)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def begin_worker() -> None:
    """Make this process a worker: one thread for every numerical library, and an end soon after its parent's."""
    os.environ.update(SINGLE_THREAD)
    if os.environ.get(SAFE_PATH) == SET_BY_US:  # not for what the worker itself starts
        del os.environ[SAFE_PATH]
    parent = parent_process()
    if parent is not None:
        end_after(parent.sentinel)


def processor_time(_: object = None) -> tuple[int, float]:
    """Return the id of this process, and the processor time that it has used, seconds; the argument is ignored."""
    return os.getpid(), time.process_time()


def end_after(sentinel: int) -> None:
    """End this process soon after a descriptor becomes readable or is closed at its other end, whatever it is doing.

    A parent that is killed cannot end its workers.
    """

    def wait() -> None:
        connection.wait([sentinel])
        time.sleep(PARENT_GONE_GRACE)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def worker_pool(workers: int, start: Callable[..., None], *arguments: Any) -> ProcessPoolExecutor:
    """Make a pool of workers that each begin with `start(*arguments)`.

    Both are sent by value where they come from the main script, so that code from a notebook or stdin works.

    Args:
        workers: How many at most; fewer where this process may open few files.
        start: What each of them begins with.
        arguments: Its arguments.

    Raises:
        OSError: There is no shared memory for the pool's semaphores.
    """
    import cloudpickle

    context, begin = worker_context(), cloudpickle.dumps((start, arguments))
    workers = min(workers, affordable_workers())
    try:
        return ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_in_pool, initargs=(begin,))
    except OSError as error:
        if error.errno not in NO_SHARED_MEMORY:
            raise
        raise OSError(
            f"Worker processes need semaphores, which lie in shared memory, and /dev/shm refuses them: "
            f"{error.strerror}. Make it writable; in a container start it with --shm-size=64m or --tmpfs /dev/shm"
        ) from error


@contextlib.contextmanager
def started_pool(
    workers: int, start: Callable[..., None], *arguments: Any, timeout: float
) -> Iterator[ProcessPoolExecutor]:
    """Make a pool as `worker_pool` does, wait until a worker has started, and kill them all at the end of the block.

    Args:
        workers: How many.
        start: What each of them begins with.
        arguments: Its arguments.
        timeout: Longest time in s that starting may take.

    Raises:
        NoWorkers: They die as they start, or take too long.
        OSError: There is no shared memory for the pool's semaphores.
    """
    pool = worker_pool(workers, start, *arguments)
    try:
        try:
            pool.submit(_do_nothing).result(timeout=timeout)
        except BrokenProcessPool as error:
            raise NoWorkers(f"Worker processes die as they start.{guard_hint()}") from error
        except TimeoutError as error:
            raise NoWorkers(f"Worker processes have not started within {timeout:g} s.") from error
        yield pool
    finally:
        kill_pool(pool)


def kill_pool(pool: ProcessPoolExecutor) -> None:
    """End a pool and its workers now, whatever they are doing."""
    processes = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    end_processes(processes, (BaseProcess.terminate, 2.0), (BaseProcess.kill, 0.5))


def end_processes(
    processes: Sequence[BaseProcess], *stages: tuple[Callable[[BaseProcess], None] | None, float]
) -> None:
    """End child processes, by harder means from stage to stage.

    Args:
        processes: Children of this process.
        stages: What is done to those still alive, or None to wait only, and the seconds they are given to end.
    """
    for stop, patience in stages:
        alive = [process for process in processes if process.is_alive()]
        for process in alive:
            if stop is not None:
                stop(process)
        deadline = time.monotonic() + patience
        for process in alive:
            process.join(max(0.0, deadline - time.monotonic()))


def affordable_workers() -> int:
    """Count the workers of a pool for which this process may open enough files, two each."""
    try:
        import resource
    except ImportError:  # on Windows
        return sys.maxsize
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return sys.maxsize if limit == resource.RLIM_INFINITY else max(1, (limit - OPEN_FILES) // 2)


def _do_nothing() -> None:
    """Return: a worker that can has started."""


def _begin_in_pool(pickled: bytes) -> None:
    import cloudpickle

    begin_worker()
    start, arguments = cloudpickle.loads(pickled)
    start(*arguments)
