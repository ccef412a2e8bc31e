from __future__ import annotations

import time

from dynaforge.benchmarks import vector as bench_vector
from dynaforge.benchmarks.episodes import BusyLoopEnv
from dynaforge.sampling.vector_env import SharedMemoryVecEnv
from dynaforge.tasks import get_task

CAN = get_task("can")


def test_what_vectorising_wastes_is_what_the_overhead_says(monkeypatch):
    step = SharedMemoryVecEnv.step

    def wasteful(env, actions):
        end = time.thread_time() + 2e-3
        while time.thread_time() < end:
            pass
        return step(env, actions)

    monkeypatch.setattr(SharedMemoryVecEnv, "step", wasteful)
    overheads, gains = bench_vector.overhead_and_gain(
        lambda: BusyLoopEnv(1e-4), "test", rounds=2, n_envs=2, n_workers=1, n_steps=10
    )
    assert len(overheads) == len(gains) == 2
    assert all(1e-3 <= value < 2e-3 for value in overheads)  # 2 ms per step of two envs, and its own cost
    assert all(value > 0.0 for value in gains)


def test_a_killed_worker_is_reported_with_its_name_and_leaves_nothing_behind():
    (figure,) = bench_vector.worker_killed(CAN, rounds=1, n_envs=2)
    assert figure.ok, figure
    assert "condition" in figure.raw["kills"][0]["error"]
