"""Noise by job: what is learned does not depend on how many envs the rollouts run in."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from small_models import envs, equal, small, weights
from stable_baselines3.common.vec_env import DummyVecEnv
from toy_envs import MatchEnv

from dynaforge.algos import FrontierGRPO
from dynaforge.sampling.vector_env import SharedMemoryVecEnv

JOB = {"exploration": "job", "learning_rate": 1e-2, "batch_size": 8, "resample_max": 1}
SDE = {"use_sde": True}
KINDS = [
    pytest.param({}, marks=pytest.mark.slow),
    SDE,
    pytest.param(SDE | {"sde_sample_freq": 2}, marks=pytest.mark.slow),
]
uneven = partial(envs, short_when_easy=True)


@pytest.mark.parametrize("kind", KINDS)
def test_results_do_not_depend_on_the_number_of_envs(kind):
    one, *others = (small(uneven(n), **JOB, **kind).learn(200) for n in (1, 2, 4))
    assert one.optimizer_steps > 0
    for other in others:
        assert equal(weights(one), weights(other))
        np.testing.assert_array_equal(one.last_group_success, other.last_group_success)
        assert one.num_timesteps == other.num_timesteps
    one, two = (small(uneven(n), **JOB | {"exploration": "stream"}, **kind).learn(200) for n in (1, 2))
    assert not equal(weights(one), weights(two)), "from one stream of noise they do depend on it"


def test_discrete_actions_do_not_either():
    def model(n):
        env = DummyVecEnv([partial(gym.make, "CartPole-v1")] * n)
        return small(env, **JOB | {"group_filter": "mixed_return", "max_episode_steps": 20}).learn(1)

    assert equal(weights(model(1)), weights(model(3)))


@pytest.mark.slow
def test_worker_processes_do_not_either():
    vector = SharedMemoryVecEnv([MatchEnv] * 4, n_workers=2)
    try:
        there = small(vector, **JOB).learn(100)
    finally:
        vector.close()
    assert equal(weights(there), weights(small(envs(3), **JOB).learn(100)))


@pytest.mark.parametrize("kind", KINDS[:2])
def test_rollouts_iterations_and_seeds_explore_differently(kind):
    def first_actions(**options):
        model = small(envs(3), **{"exploration": "job", "group_filter": "none", "learning_rate": 0.0} | kind | options)
        found = []
        for _ in range(2):
            model.learn(1, reset_num_timesteps=False)
            found.append(model.rollout_buffer.actions[:, 0])
        return np.concatenate(found)

    noise = first_actions()
    assert len(set(noise.tolist())) == len(noise) == 2 * 16 * 3
    assert not set(noise.tolist()) & set(first_actions(seed=1).tolist())
    spread, expected = (first_actions(n_groups=32, exploration=e).std() for e in ("job", "stream"))
    assert spread == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("kind", KINDS[:2])
def test_a_saved_model_goes_on_with_the_same_noise_in_another_number_of_envs(tmp_path, kind):
    whole = small(envs(3), **JOB, **kind).learn(144)
    whole.save(tmp_path / "m")
    whole.learn(144, reset_num_timesteps=False)
    resumed = FrontierGRPO.load(tmp_path / "m", env=envs(2), device="cpu")
    resumed.learn(144, reset_num_timesteps=False)
    assert equal(weights(whole), weights(resumed))
    assert whole.iterations == resumed.iterations > 2
