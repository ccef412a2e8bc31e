"""The interval of a difference holds with few training seeds, where a bootstrap of them is too narrow."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import ttest_ind

from dynaforge.evaluation import bootstrap_over_tasks
from dynaforge.evaluation.few_seeds import few_seeds_interval

BASE, GAIN, SEED_SD, CONDITION_SD = 0.6, 0.1, 0.08, 0.12  # 8 points of spread between seeds


def runs(rng: np.random.Generator, gain: float, conditions: np.ndarray, seed_sd: float) -> np.ndarray:
    rates = BASE + gain + rng.normal(0.0, seed_sd, (3, 1)) + conditions
    return rng.random(rates.shape) < rates


def drawn_pair(rng: np.random.Generator, seed_sd: float = SEED_SD) -> tuple[np.ndarray, np.ndarray]:
    conditions = rng.normal(0.0, CONDITION_SD, (1, 300)).clip(-0.25, 0.25)  # rates stay within [0, 1]
    return runs(rng, 0.0, conditions, seed_sd), runs(rng, GAIN, conditions, seed_sd)


def coverage(n: int, *, tasks: int, seed_sd: float) -> float:
    rng, held = np.random.default_rng(0), 0
    for _ in range(n):
        low, high = few_seeds_interval([drawn_pair(rng, seed_sd) for _ in range(tasks)])
        held += low <= GAIN <= high
    return held / n


@pytest.mark.parametrize(
    ("tasks", "seed_sd"), [(1, SEED_SD), pytest.param(4, SEED_SD, marks=pytest.mark.slow), (1, 0.0)]
)
def test_three_seeds_hold_the_difference_as_often_as_promised(tasks, seed_sd):
    assert 0.93 <= coverage(600, tasks=tasks, seed_sd=seed_sd) <= 0.99


@pytest.mark.slow
def test_a_bootstrap_of_three_seeds_that_disagree_is_too_narrow():
    rng, held = np.random.default_rng(0), 0
    for _ in range(150):
        interval = bootstrap_over_tasks([drawn_pair(rng)], rng=rng, resamples=200).interval
        held += interval.low <= GAIN <= interval.high
    assert held / 150 < 0.91


def test_seeds_alone_give_welch_s_interval():
    # Outcomes that depend on the seed alone: nothing is left for conditions, and Welch's test is exact.
    a, b = (np.repeat([[s] for s in seeds], 40, axis=1) for seeds in ([0, 1, 0, 0], [1, 1, 1, 0, 1]))
    welch = ttest_ind(b[:, 0], a[:, 0], equal_var=False).confidence_interval(0.95)
    assert few_seeds_interval([(a, b)]) == pytest.approx((welch.low, welch.high))


def test_a_seed_alone_tells_nothing_of_the_spread_and_equal_runs_have_none():
    some = np.tile(np.arange(10) % 2, (3, 1))
    assert few_seeds_interval([(some, some[:1])]) == (-math.inf, math.inf)
    assert few_seeds_interval([(some, some)]) == (0.0, 0.0)


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ValueError, match="no task"):
        few_seeds_interval([])
    with pytest.raises(ValueError, match=r"equal C; given \(3, 4\) and \(3, 5\)"):
        few_seeds_interval([(np.ones((3, 4)), np.ones((3, 5)))])
    with pytest.raises(ValueError, match="between 0 and 1"):
        few_seeds_interval([(np.ones((3, 4)), np.ones((3, 4)))], confidence=95)
