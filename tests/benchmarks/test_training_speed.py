from __future__ import annotations

import time

import numpy as np
import pytest

from dynaforge.benchmarks import training as bench_training
from dynaforge.tasks import get_task

CAN = get_task("can")


@pytest.mark.slow
def test_the_trainer_is_measured_against_ppo_on_equal_transitions() -> None:
    (figure,) = bench_training.trainer(CAN, rounds=1)
    seconds = figure.raw["cpu_seconds"]
    assert len(seconds["frontier_grpo"]) == len(seconds["ppo"]) == 2
    assert all(0 < value < 1e-3 for row in seconds.values() for value in row)


def test_a_timed_env_counts_only_its_steps() -> None:
    env = bench_training.TimedEnv("can")
    env.reset(seed=0)
    assert env.cpu == 0.0
    start = time.process_time()
    env.step(np.zeros(env.action_space.shape, np.float32))
    assert 0.0 < env.cpu <= time.process_time() - start
    env.close()
