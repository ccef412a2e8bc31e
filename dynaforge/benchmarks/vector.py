"""Figures of the vectorised env: what it costs, what it gains, and what happens when a worker dies."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynaforge.benchmarks.episodes import BusyLoopEnv, HashingEnv
from dynaforge.benchmarks.figure import Figure, spread, tracked
from dynaforge.registration import env_id
from dynaforge.sampling.vector_env import SharedMemoryVecEnv, WorkerDied
from dynaforge.tasks import Task

MAX_OVERHEAD = 20e-6  # CPU seconds per step of an env, beyond the env's own
MIN_GAIN, MIN_OWN_GAIN = 1.7, 1.75  # times one env's throughput, with two workers; the second of a task's own env
MAX_ERROR_SECONDS, MAX_CLOSE_SECONDS = 5.0, 2.0
KILL_AFTER = 0.15  # seconds into the rollout

EnvFn = Callable[[], gym.Env[Any, Any]]


def vectorised(
    task: Task, *, rounds: int = 5, n_envs: int = 16, n_workers: int = 2, n_steps: int = 150
) -> list[Figure]:
    """Measure overhead and gain on an env of known cost, and the gain on the task's own env.

    Args:
        task: The task.
        rounds: Number of rounds; vectorised env and single env take turns in each.
        n_envs: Number of envs.
        n_workers: Number of worker processes.
        n_steps: Steps of the vectorised env per round.
    """
    size = f"{n_envs} envs, {n_workers} workers"
    measure = partial(overhead_and_gain, rounds=rounds, n_envs=n_envs, n_workers=n_workers, n_steps=n_steps)
    overheads, _ = measure(partial(BusyLoopEnv, 2e-4), "overhead")
    _, gains = measure(partial(BusyLoopEnv, 1e-3), "gain, 1 ms env")
    own_costs, own_gains = measure(partial(gym.make, env_id(task.name), gate_mode="mask"), f"gain, {task.name}")
    micro = [1e6 * value for value in overheads]
    return [
        Figure(
            title=f"vectorised overhead per env step, {size}",
            target="<= 20 us of CPU",
            measured=f"{spread(micro, digits=1)} us",
            ok=median(overheads) <= MAX_OVERHEAD,
            raw={"cpu_seconds": overheads},
        ),
        Figure(
            title=f"throughput over one 1 ms env, {size}",
            target=">= 1.7",
            measured=spread(gains),
            ok=median(gains) >= MIN_GAIN,
            raw={"ratio": gains},
        ),
        Figure(
            title=f"throughput over one {task.env_name} env, {size}",
            target=">= 1.75",
            measured=spread(own_gains),
            ok=median(own_gains) >= MIN_OWN_GAIN,
            raw={"ratio": own_gains, "cpu_seconds_beside_one_env": own_costs},
        ),
    ]


def overhead_and_gain(
    make: EnvFn, title: str, *, rounds: int, n_envs: int, n_workers: int, n_steps: int
) -> tuple[list[float], list[float]]:
    """Compare a vectorised env with one env in this process, under the same random actions.

    Args:
        make: Makes an env.
        title: Text in front of the progress bar.
        rounds: Number of rounds.
        n_envs: Number of envs.
        n_workers: Number of worker processes.
        n_steps: Steps of the vectorised env per round.

    Returns:
        For each round the CPU seconds per env step (this process and the workers) beyond the single env's, and the
        throughput by the clock over the single env's.
    """
    one = make()
    env = SharedMemoryVecEnv([_Timed(make)] * n_envs, n_workers=n_workers)
    overheads, gains = [], []
    try:
        rng = np.random.default_rng(0)
        actions = rng.uniform(-1, 1, (n_steps, n_envs, *(one.action_space.shape or ()))).astype(np.float32)
        one.reset(seed=0)
        env.seed(0)
        env.reset()
        for action in actions[:10]:
            env.step(action)
        for _ in tracked(range(rounds), title, total=rounds):
            single_wall, single_cpu = _cost_of_single(one, actions, n_steps * n_envs // n_workers)
            wall, cpu = _cost_of_vectorised(env, actions)
            overheads.append(cpu - single_cpu)
            gains.append(single_wall / wall)
    finally:
        one.close()
        env.close()
    return overheads, gains


def _cost_of_single(env: gym.Env[Any, Any], actions: NDArray[np.float32], n: int) -> tuple[float, float]:
    """Make n steps in this process; return wall and CPU seconds per step."""
    n_steps, n_envs = actions.shape[:2]
    wall, cpu = time.perf_counter(), time.process_time()
    for k in range(n):
        _, _, terminated, truncated, _ = env.step(actions[k % n_steps, k % n_envs])
        if terminated or truncated:
            env.reset()
    return (time.perf_counter() - wall) / n, (time.process_time() - cpu) / n


def _cost_of_vectorised(env: SharedMemoryVecEnv, actions: NDArray[np.float32]) -> tuple[float, float]:
    """Step all envs through the actions, shape (T, n_envs, d); return wall and CPU seconds per env step."""
    n = actions.shape[0] * actions.shape[1]
    wall, cpu = time.perf_counter(), _processor_time(env)
    for action in actions:
        env.step(action)
    return (time.perf_counter() - wall) / n, (_processor_time(env) - cpu) / n


class _Timed:
    """Makes an env that reports the CPU time of its process."""

    def __init__(self, make: EnvFn) -> None:
        self._make = make

    def __call__(self) -> gym.Env[Any, Any]:
        env = self._make()
        if not hasattr(env.unwrapped, "processor_time"):
            env.unwrapped.processor_time = partial(BusyLoopEnv.processor_time, None)  # type: ignore[attr-defined, arg-type]
        return env


def _processor_time(env: SharedMemoryVecEnv) -> float:
    """Return the CPU seconds used so far by this process and the workers."""
    return time.process_time() + sum(dict(env.env_method("processor_time")).values())


def worker_killed(task: Task, *, rounds: int = 3, n_envs: int = 4, n_workers: int = 2) -> list[Figure]:
    """Kill a worker in the middle of a rollout; time the error and `close()`, and look for processes left behind.

    Args:
        task: The task.
        rounds: Number of kills.
        n_envs: Number of envs.
        n_workers: Number of worker processes.
    """
    raw = [_kill_one(task.name, n_envs, n_workers) for _ in tracked(range(rounds), "worker killed", total=rounds)]
    error, close = (max(result[name] for result in raw) for name in ("error_seconds", "close_seconds"))
    orphans = sum(result["orphans"] for result in raw)
    return [
        Figure(
            title="a worker killed mid-rollout",
            target="error <= 5 s, close <= 2 s, no orphan",
            measured=f"error in {error:.2f} s, close in {close:.2f} s, {orphans} orphans, {rounds} kills",
            ok=error <= MAX_ERROR_SECONDS and close <= MAX_CLOSE_SECONDS and orphans == 0,
            raw={"kills": raw},
        )
    ]


def _kill_one(task: str, n_envs: int, n_workers: int) -> dict[str, Any]:
    env = SharedMemoryVecEnv([partial(HashingEnv, task, "mask")] * n_envs, n_workers=n_workers)
    killed_at: list[float] = []
    try:
        env.seed(0)
        env.reset()
        pids = sorted(set(env.env_method("pid")))
        threading.Timer(KILL_AFTER, _kill, (pids[-1], killed_at)).start()
        message = _roll_until_death(env, time.monotonic() + KILL_AFTER + 2 * MAX_ERROR_SECONDS)
        error_seconds = time.monotonic() - killed_at[0] if killed_at and message else float("inf")
    finally:
        begin = time.monotonic()
        env.close()
        close_seconds = time.monotonic() - begin
    orphans = sum(_alive_after(pid, seconds=1.0) for pid in pids)
    return {"error_seconds": error_seconds, "close_seconds": close_seconds, "orphans": orphans, "error": message}


def _roll_until_death(env: SharedMemoryVecEnv, deadline: float) -> str:
    """Step until a worker is reported dead; return that message, or "" if none came before the deadline."""
    actions = np.zeros((env.num_envs, *(env.action_space.shape or ())), np.float32)
    try:
        while time.monotonic() < deadline:
            env.step(actions)
    except WorkerDied as error:
        return str(error)
    return ""


def _kill(pid: int, killed_at: list[float]) -> None:
    killed_at.append(time.monotonic())
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def _alive_after(pid: int, *, seconds: float) -> bool:
    """Return whether a process still runs after a time in which the system may clear it away."""
    deadline = time.monotonic() + seconds
    while _runs(pid):
        if time.monotonic() >= deadline:
            return True
        time.sleep(0.02)
    return False


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with contextlib.suppress(OSError):  # no /proc here, or gone meanwhile: the next poll will tell
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return True
