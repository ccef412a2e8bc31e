from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from dynaforge.algos.buffer import GroupRolloutBuffer
from dynaforge.sampling.sampler import Group, Job

OBS = gym.spaces.Box(-np.inf, np.inf, (1,), np.float64)
ACT = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)

JOBS = [Job(group, rollout) for group in (Group(0, None, "a", {}), Group(1, None, "b", {})) for rollout in (0, 1)]


def filled(schedule: list[list[tuple[int, int]]]) -> GroupRolloutBuffer:
    """Fill a buffer with steps of (job, time); the time is the observation, every third time is ungated."""
    buffer = GroupRolloutBuffer(4, OBS, ACT, device="cpu", gae_lambda=1.0, gamma=1.0, n_envs=3)
    for step in schedule:
        numbers, times = np.array(step).T
        jobs = [JOBS[number] for number in numbers]
        obs = (10.0 * numbers + times)[:, None]
        log_probs = obs[:, 0].astype(np.float32)
        buffer.add(obs, np.zeros((len(jobs), 2), np.float32), log_probs, times % 2 == 1, times % 3 != 2, jobs)
    buffer.finish()
    return buffer


ONE_ENV = [[(j, t)] for j, length in enumerate([2, 3, 1, 4]) for t in range(length)]
TWO_ENVS = [[(0, 0), (1, 0)], [(1, 1), (0, 1)], [(1, 2), (3, 0)], [(2, 0), (3, 1)], [(3, 2)], [(3, 3)]]


def test_order_does_not_depend_on_which_env_ran_a_job():
    a, b = filled(ONE_ENV), filled(TWO_ENVS)
    np.testing.assert_array_equal(a.observations, b.observations)
    np.testing.assert_array_equal(a.groups, [0, 0, 0, 0, 0, 1, 1, 1, 1, 1])
    np.testing.assert_array_equal(a.rollouts, [0, 0, 1, 1, 1, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(a.log_probs, b.log_probs)
    np.testing.assert_array_equal(a.mask, b.mask)
    np.testing.assert_array_equal(a.at_rim, b.at_rim)
    np.testing.assert_array_equal(a.at_rim, a.observations[:, 0] % 10 % 2 == 1)


def test_only_gated_transitions_of_kept_groups_are_used():
    kept = filled(TWO_ENVS).keep(np.array([False, True]), np.array([[1.0, 2.0], [3.0, 4.0]]))
    assert kept.observations[:, 0].tolist() == [20.0, 30.0, 31.0, 33.0]  # group 1 is jobs 2 and 3; 32 is ungated
    assert kept.advantages.tolist() == [3.0, 4.0, 4.0, 4.0]
    assert str(kept.observations.dtype) == str(kept.advantages.dtype) == "torch.float32"


def test_episode_weights_give_each_episode_one_share():
    kept = filled(ONE_ENV).keep(np.array([False, True]), np.zeros((2, 2)), loss_agg="episode")
    np.testing.assert_allclose(kept.weights, [2.0, 2 / 3, 2 / 3, 2 / 3])
    assert kept.weights.mean().item() == pytest.approx(1.0)


def test_time_order_within_a_job_survives_many_steps():
    buffer = filled([[(1, t), (0, t)] for t in range(500)])
    np.testing.assert_array_equal(buffer.observations[:, 0], np.concatenate([np.arange(500), 10 + np.arange(500)]))


@pytest.mark.parametrize("n", [1, 2, 3, 100])
def test_minibatches_hold_every_transition_once_in_equal_parts(n):
    kept = filled(ONE_ENV).keep(np.array([True, True]), np.zeros((2, 2)))
    parts = list(kept.minibatches(n, np.random.default_rng(0)))
    sizes = [len(part) for part in parts]
    assert len(parts) == n
    assert max(sizes) - min(sizes) <= 1
    seen = sorted(x for part in parts for x in part.observations[:, 0].tolist())
    assert seen == sorted(kept.observations[:, 0].tolist())
    for part in parts:
        assert part.observations[:, 0].tolist() == part.log_probs.tolist()


def test_minibatches_follow_the_generator_given():
    kept = filled(ONE_ENV).keep(np.array([True, True]), np.zeros((2, 2)))

    def order(seed):
        return [part.log_probs.tolist() for part in kept.minibatches(3, np.random.default_rng(seed))]

    assert order(1) == order(1) != order(2)


def test_an_empty_buffer_is_refused():
    with pytest.raises(ValueError, match="empty"):
        filled([])
