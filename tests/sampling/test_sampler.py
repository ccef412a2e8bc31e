from __future__ import annotations

import pickle

import gymnasium as gym
import numpy as np
import pytest

from dynaforge.sampling.sampler import SeedConditionSampler, StratifiedSampler


class Recorder:
    """Condition = (stratum, n_strata, number drawn)."""

    def draw(self, rng, stratum=None, n_strata=1):
        return stratum, n_strata, int(rng.integers(1000))

    def reset_kwargs(self, condition):
        return {"options": {"condition": condition}}


def test_each_stratum_is_drawn_once():
    groups = StratifiedSampler(4, 3).draw(Recorder(), np.random.default_rng(0))
    assert [group.condition[:2] for group in groups] == [(0, 4), (1, 4), (2, 4), (3, 4)]
    assert [group.stratum for group in groups] == [0, 1, 2, 3]


def test_without_strata_conditions_come_from_the_whole_range():
    groups = StratifiedSampler(4, 3, stratified=False).draw(Recorder(), np.random.default_rng(0))
    assert [group.condition[:2] for group in groups] == [(None, 1)] * 4


def test_jobs_of_a_group_share_their_condition():
    sampler = StratifiedSampler(4, 3)
    jobs = sampler.jobs(sampler.draw(Recorder(), np.random.default_rng(0)))
    assert sorted((job.group.index, job.rollout) for job in jobs) == [(n, k) for n in range(4) for k in range(3)]
    assert len(set(jobs)) == 12
    assert len({job.group for job in jobs}) == 4
    assert all(job.group.stratum == job.group.index for job in jobs)


def test_any_few_jobs_in_a_row_are_spread_over_the_strata():
    sampler = StratifiedSampler(4, 3)
    strata = [job.group.stratum for job in sampler.jobs(sampler.draw(Recorder(), np.random.default_rng(0)))]
    assert strata == [0, 2, 1, 3] * 3


def test_the_generator_alone_decides_what_is_drawn():
    def draw(seed):
        return [g.condition for g in StratifiedSampler(4, 3).draw(Recorder(), np.random.default_rng(seed))]

    assert draw(1) == draw(1) != draw(2)


def test_replacements_come_from_the_strata_named_and_continue_the_numbering():
    groups = StratifiedSampler(4, 2).draw(Recorder(), np.random.default_rng(0), strata=[3, 1], first_index=4)
    assert [(group.index, group.condition[:2]) for group in groups] == [(4, (3, 4)), (5, (1, 4))]
    jobs = StratifiedSampler(4, 2).jobs(groups)
    assert [(job.group.index, job.rollout) for job in jobs] == [(5, 0), (4, 0), (5, 1), (4, 1)]


def test_equal_seeds_start_equal_episodes():
    sampler = pickle.loads(pickle.dumps(SeedConditionSampler()))
    seed = sampler.draw(np.random.default_rng(0), 2, 4)
    env = gym.make("CartPole-v1")
    a, b = (env.reset(**sampler.reset_kwargs(seed))[0] for _ in range(2))
    np.testing.assert_array_equal(a, b)
    assert seed != sampler.draw(np.random.default_rng(1))


@pytest.mark.parametrize("sizes", [(0, 4), (4, 0)])
def test_empty_groups_are_refused(sizes):
    with pytest.raises(ValueError, match="at least 1"):
        StratifiedSampler(*sizes)
