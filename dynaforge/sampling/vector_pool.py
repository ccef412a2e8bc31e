"""The parent's side of the env workers: start them, exchange messages with a limit on every wait, end them."""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import tempfile
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing import reduction
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import gymnasium as gym

from dynaforge.sampling.interrupts import signals_deferred
from dynaforge.sampling.processes import end_processes, guard_hint, worker_context, worker_environment
from dynaforge.sampling.vector_errors import RemoteTraceback, WorkerDied, WorkerFailed, exit_reason
from dynaforge.sampling.vector_worker import (
    CLOSE,
    EMPTY,
    FAILURE,
    NO_ENV,
    Layout,
    SharedArrays,
    dump,
    run_worker,
)

START_TIMEOUT = 60.0  # s; imports on a busy machine are slow whatever limit the envs have
# close(): seconds given to asking, to SIGTERM and to SIGKILL, together under 2 s.
ASK_PATIENCE, TERMINATE_PATIENCE, KILL_PATIENCE = 1.0, 0.3, 0.5

NO_TICK = -1

EnvFn = Callable[[], gym.Env[Any, Any]]


class WorkerPool:
    """A few processes, each with a contiguous share of the envs.

    Args:
        env_fns: One function per env; anything cloudpickle can send.
        n_workers: Processes, at most one per env.
        timeout: Longest time in s that one call into one env may take.

    Attributes:
        spaces: Per env its (observation space, action space).
        shares: Per worker the indices of its envs.
        labels: Per env a description of what it runs, for errors.

    Raises:
        WorkerFailed: An env function raised an exception.
        WorkerDied: A worker ended or gave no answer while starting.
    """

    def __init__(self, env_fns: Sequence[EnvFn], *, n_workers: int, timeout: float) -> None:
        pickled = [_pickle_fn(index, env_fn) for index, env_fn in enumerate(env_fns)]
        n = len(pickled)
        self.shares = [range(n * w // n_workers, n * (w + 1) // n_workers) for w in range(n_workers)]
        self.labels = ["its construction"] * n
        self._arrays: SharedArrays | None = None
        self._pending: set[int] = set()
        self._limit = max(timeout, START_TIMEOUT)
        self._processes: list[BaseProcess] = []
        self._pipes: list[Connection[Any, Any]] = []
        self._closer = weakref.finalize(self, _end_workers, self._processes, self._pipes, os.getpid())
        try:
            self._start()
            orders = {w: pickle.dumps([pickled[i] for i in share]) for w, share in enumerate(self.shares)}
            answers = self.exchange(orders)
        except BaseException:
            self.close()
            raise
        self.spaces: list[tuple[gym.Space[Any], gym.Space[Any]]] = [
            pair for w in range(n_workers) for pair in answers[w]
        ]
        self.labels = ["no episode yet"] * n
        self._limit = timeout

    def share(self, layout: Layout) -> SharedArrays:
        """Create the shared block, hand it to every worker, and return its arrays.

        The block has no name: the kernel frees it with the last process, however that ends.
        """
        with _anonymous_file() as descriptor:
            os.ftruncate(descriptor, layout.size)
            arrays = layout.map(descriptor)
            arrays["running"][:] = NO_ENV
            for worker, (pipe, process) in enumerate(zip(self._pipes, self._processes, strict=True)):
                try:
                    pipe.send_bytes(pickle.dumps(layout))
                    reduction.send_handle(pipe, descriptor, process.pid)
                except OSError:
                    raise self._died(worker) from None
        self._arrays = arrays
        return arrays

    def post(self, messages: Mapping[int, bytes]) -> None:
        """Send one command to each of the given workers; answers that an interrupted wait left unread are dropped."""
        if not self._closer.alive:
            raise RuntimeError("This vectorised env is closed; make a new one.")
        if self._pending:
            self._await()
        for worker, message in messages.items():
            try:
                with signals_deferred():  # otherwise a sent but unrecorded command leaves its answer to the next
                    self._pipes[worker].send_bytes(message)
                    self._pending.add(worker)
            except OSError:
                raise self._died(worker) from None

    def collect(self) -> dict[int, Any]:
        """Wait for the answer of every worker that has a command and return the payloads by worker.

        Raises:
            WorkerDied: A worker is gone, or one call into an env took longer than the time limit.
            WorkerFailed: An env raised an exception.
        """
        payloads: dict[int, Any] = {}
        failures: dict[int, bytes] = {}
        for worker, answer in self._await().items():
            if answer[:1] == FAILURE:
                failures[worker] = answer
            else:
                payloads[worker] = None if answer == EMPTY else pickle.loads(memoryview(answer)[1:])
        for worker, answer in failures.items():
            raise self._failed(worker, *pickle.loads(answer[1:]))
        return payloads

    def exchange(self, messages: Mapping[int, bytes]) -> dict[int, Any]:
        """Send commands and wait for their answers."""
        self.post(messages)
        return self.collect()

    def close(self) -> None:
        """End every worker: asked, then terminated, then killed. Returns within 2 s and may be called again."""
        self._closer()
        self._arrays = None

    def _start(self) -> None:
        context = worker_context()
        self._poll = select.poll()
        self._owner: dict[int, int] = {}
        with worker_environment():
            for worker, share in enumerate(self.shares):
                pipe, far_end = context.Pipe()
                process: BaseProcess = context.Process(
                    target=run_worker, args=(far_end, worker, share.start), name=f"env-worker-{worker}", daemon=True
                )
                process.start()
                far_end.close()
                self._processes.append(process)
                self._pipes.append(pipe)
                for descriptor in (pipe.fileno(), process.sentinel):
                    self._poll.register(descriptor, select.POLLIN)
                    self._owner[descriptor] = worker

    def _await(self) -> dict[int, bytes]:
        answers = {}
        seen: dict[int, tuple[int, float]] = {}
        while self._pending:
            events = self._poll.poll(1000.0 * min(1.0, self._limit / 4.0))
            for descriptor, _ in events:
                worker = self._owner[descriptor]
                answers[worker] = self._read(worker, descriptor)
            if not events:
                self._check_progress(seen)
        return answers

    def _read(self, worker: int, descriptor: int) -> bytes:
        pipe = self._pipes[worker]
        try:
            # A worker without a pending command is only heard of when it dies; one that died may have answered before.
            if worker not in self._pending or (descriptor != pipe.fileno() and not pipe.poll()):
                raise EOFError
            with signals_deferred():  # no answer may be read by half, or be read and still count as pending
                answer = pipe.recv_bytes()
                self._pending.discard(worker)
        except (EOFError, OSError):
            raise self._died(worker) from None
        return answer

    def _check_progress(self, seen: dict[int, tuple[int, float]]) -> None:
        now = time.monotonic()
        for worker in self._pending:
            tick, since = seen.get(worker, (NO_TICK, now))
            if self._tick(worker) != tick:
                seen[worker] = (self._tick(worker), now)
            elif now - since >= self._limit:
                self._processes[worker].kill()
                raise self._died(worker, f"gave no answer for {self._limit:g} s and was killed")

    def _tick(self, worker: int) -> int:
        return 0 if self._arrays is None else int(self._arrays["ticks"][worker])

    def _died(self, worker: int, what: str | None = None) -> WorkerDied:
        self._pending.discard(worker)
        process = self._processes[worker]
        process.join(1.0)  # the exit status comes later than the broken pipe
        what = what or f"died ({exit_reason(process.exitcode)})"
        index = NO_ENV if self._arrays is None else int(self._arrays["running"][worker])
        if index != NO_ENV:
            condition, where = self.labels[index], f"in env {index}, which ran {self.labels[index]}"
        else:
            condition = ", ".join(f"env {i}: {self.labels[i]}" for i in self.shares[worker])
            where = f"between two calls; its envs were {condition}"
        hint = guard_hint() if self._arrays is None else ""
        message = f"Worker {worker} {what} {where}. Close this vectorised env and make a new one.{hint}"
        return WorkerDied(message, worker=worker, env_index=None if index == NO_ENV else index, condition=condition)

    def _failed(self, worker: int, index: int | None, error_type: str, message: str, text: str) -> WorkerFailed:
        condition = "no episode" if index is None else self.labels[index]
        where = f"worker {worker}" if index is None else f"env {index} of worker {worker}, which ran {condition}"
        failure = WorkerFailed(
            f"{error_type} in {where}: {message}",
            worker=worker,
            env_index=index,
            condition=condition,
            error_type=error_type,
        )
        failure.__cause__ = RemoteTraceback(text)
        return failure


def _end_workers(processes: Sequence[BaseProcess], pipes: Sequence[Connection[Any, Any]], owner: int) -> None:
    if os.getpid() != owner:  # a forked copy of the owner must not end its workers
        return
    for pipe in pipes:
        with contextlib.suppress(OSError):
            pipe.send_bytes(CLOSE)
    end_processes(
        processes,
        (None, ASK_PATIENCE),
        (BaseProcess.terminate, TERMINATE_PATIENCE),
        (BaseProcess.kill, KILL_PATIENCE),
    )
    for pipe in pipes:
        pipe.close()


def _pickle_fn(index: int, env_fn: EnvFn) -> bytes:
    if not callable(env_fn):
        raise TypeError(f"env_fns[{index}] is {type(env_fn).__name__}, expected a function that makes an env.")
    try:
        return dump(env_fn)
    except (pickle.PicklingError, TypeError) as error:
        raise TypeError(f"env_fns[{index}] cannot be sent to a worker process: {error}. Make the env in it.") from error


@contextlib.contextmanager
def _anonymous_file() -> Iterator[int]:
    """Open a file without a name: in memory on Linux (not limited by the size of /dev/shm), temporary elsewhere."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("dynaforge-envs")
        try:
            yield descriptor
        finally:
            os.close(descriptor)
    else:
        with tempfile.TemporaryFile() as file:
            yield file.fileno()
