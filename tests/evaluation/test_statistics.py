from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dynaforge.evaluation import bootstrap_over_tasks, mcnemar_exact, paired_difference, wilson_interval
from dynaforge.evaluation.statistics import BootstrapDifference, no_bin_worse, wilson_bounds


def bootstrap_over(a: Any, b: Any, **options: Any) -> BootstrapDifference:
    return bootstrap_over_tasks([(a, b)], **options)


def pairs(both: int, only_a: int, only_b: int, neither: int) -> tuple[list[int], list[int]]:
    a = [1] * both + [1] * only_a + [0] * only_b + [0] * neither
    b = [1] * both + [0] * only_a + [1] * only_b + [0] * neither
    return a, b


def test_wilson_matches_hand_worked_numbers():
    # 8 of 10, z = 1.96: centre (.8 + .19208) / 1.38416 = .71674, half = 1.96 sqrt(.016 + .0096040) / 1.38416 = .22657
    assert wilson_interval(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    # 0 of 10: the upper bound is z^2 / (n + z^2) = 3.8415 / 13.8415
    assert wilson_interval(0, 10) == pytest.approx((0.0, 0.27753), abs=1e-5)
    assert wilson_interval(10, 10) == pytest.approx((0.72247, 1.0), abs=1e-5)
    # Newcombe 1998, Stat. Med. 17:857, table I: 81 of 263 and 15 of 148
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson_interval(15, 148) == pytest.approx((0.0624, 0.1605), abs=1e-4)


def test_wilson_without_trials_knows_nothing():
    assert wilson_interval(0, 0) == (0.0, 1.0)
    low, high = wilson_bounds([0, 8], [0, 10])
    np.testing.assert_allclose(low, [0.0, 0.4902], atol=1e-4)
    np.testing.assert_allclose(high, [1.0, 0.9433], atol=1e-4)


def test_wilson_refuses_impossible_counts():
    with pytest.raises(ValueError, match="between 0 and the number"):
        wilson_interval(11, 10)
    with pytest.raises(ValueError, match="Confidence"):
        wilson_interval(1, 10, confidence=95)


def test_mcnemar_matches_hand_worked_numbers():
    assert mcnemar_exact(0, 0) == 1.0
    assert mcnemar_exact(1, 5) == pytest.approx(2 * (1 + 6) / 64)
    assert mcnemar_exact(5, 1) == mcnemar_exact(1, 5)
    assert mcnemar_exact(0, 10) == pytest.approx(2 / 1024)
    assert mcnemar_exact(3, 3) == 1.0


def test_paired_difference_matches_hand_worked_numbers():
    # 36 both, 12 only b, 2 only a, 0 neither. Wilson of 48/50: .8654 to .9890, of 38/50: .6259 to .8570;
    # phi = (36 * 0 - 12 * 2) / sqrt(48 * 2 * 38 * 12) = -.11471
    # low = .2 - sqrt(.0946^2 + 2 * .11471 * .0946 * .0970 + .0970^2), high = .2 + sqrt(.0290^2 + ... + .1341^2)
    result = paired_difference(*pairs(36, 2, 12, 0))
    assert (result.n, result.both, result.only_a, result.only_b, result.neither) == (50, 36, 2, 12, 0)
    assert result.difference == pytest.approx(0.2)
    assert result.interval == pytest.approx((0.0569, 0.3404), abs=1e-4)
    assert result.p_value == pytest.approx(2 * (1 + 14 + 91) / 2**14)


def test_positive_correlation_is_continuity_corrected():
    # 20 both, 5 only b, 5 only a, 20 neither: phi = (400 - 25 - 25) / (25 * 25) = .56;
    # Wilson of 25/50: .5 -+ .13355; half width = .13355 sqrt(2 (1 - .56)) = .12528
    assert paired_difference(*pairs(20, 5, 5, 20)).interval == pytest.approx((-0.12528, 0.12528), abs=1e-4)


def test_paired_difference_changes_sign_with_the_order():
    a, b = pairs(30, 3, 20, 47)
    forth, back = paired_difference(a, b), paired_difference(b, a)
    assert back.difference == -forth.difference
    assert (-back.interval.high, -back.interval.low) == pytest.approx(forth.interval)
    assert back.p_value == forth.p_value


def test_interval_covers_the_truth_at_about_its_confidence():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(1000):
        base, extra = rng.random(100) < 0.4, rng.random(100) < 0.2
        low, high = paired_difference(base, base | extra).interval  # truth: .6 * .2
        hits += low <= 0.12 <= high
    assert 0.93 <= hits / 1000 <= 0.99


def test_pairs_must_be_pairs_of_outcomes():
    with pytest.raises(ValueError, match="two equal, non-empty"):
        paired_difference([1, 0], [1])
    with pytest.raises(ValueError, match="success"):
        paired_difference([0.5], [1])


def test_bootstrap_excludes_zero_only_for_a_real_difference():
    rng = np.random.default_rng(1)
    conditions = rng.random(300)
    weak = conditions[None] < 0.5 + 0.02 * rng.standard_normal((3, 1))
    strong = conditions[None] < 0.8 + 0.02 * rng.standard_normal((3, 1))
    result = bootstrap_over(weak, strong, rng=np.random.default_rng(2), resamples=2000)
    assert result.difference == pytest.approx(strong.mean() - weak.mean())
    assert 0.2 < result.interval.low < result.difference < result.interval.high < 0.4
    same = bootstrap_over(weak, weak, rng=np.random.default_rng(2), resamples=2000)
    assert same.interval.low <= 0 <= same.interval.high


def test_bootstrap_width_knows_both_seeds_and_conditions():
    by_seed = np.repeat([[1], [0], [1], [0]], 50, axis=1)  # differs only between seeds
    by_condition = np.tile(np.arange(50) % 2, (4, 1))  # differs only between conditions
    none = np.zeros((4, 50))
    for outcomes, n in ((by_seed, 4), (by_condition, 50)):
        low, high = bootstrap_over(none, outcomes, rng=np.random.default_rng(0), resamples=4000).interval
        assert high - low == pytest.approx(2 * 1.96 * 0.5 / np.sqrt(n), rel=0.2)


def test_bootstrap_repeats_with_its_generator():
    a, b = np.eye(3, 40), 1 - np.eye(3, 40)
    draws = [bootstrap_over(a, b, rng=np.random.default_rng(5), resamples=500) for _ in range(2)]
    assert draws[0] == draws[1]


def test_a_bin_is_worse_only_when_its_whole_interval_is_below_minus_ten_points():
    before = np.ones((8, 100), dtype=bool)
    after = before.copy()
    after[3, :15] = False  # -15 points, interval reaches above -10
    assert no_bin_worse(before, after).holds
    after[6, :30] = False
    result = no_bin_worse(before, after)
    assert result.worse == (6,)
    assert not result.holds
    assert result.bins[6].difference == pytest.approx(-0.3)
    assert no_bin_worse(after, before).holds
    with pytest.raises(ValueError, match="given 8 and 7"):
        no_bin_worse(before, after[:7])


def test_a_comparison_over_tasks_is_the_mean_of_theirs():
    rng = np.random.default_rng(3)
    weak, strong = rng.random((3, 100)) < 0.4, rng.random((3, 100)) < 0.7
    one = bootstrap_over(weak, strong, rng=np.random.default_rng(0), resamples=4000)
    none = bootstrap_over(weak, weak, rng=np.random.default_rng(0), resamples=4000)
    both = bootstrap_over_tasks([(weak, strong), (weak, weak)], rng=np.random.default_rng(0), resamples=4000)
    assert both.difference == pytest.approx((one.difference + none.difference) / 2)
    # Independent tasks: the interval of the mean is that of one by about the root of two narrower.
    width = both.interval.high - both.interval.low
    assert 0.5 < width / (one.interval.high - one.interval.low) < 0.95
    with pytest.raises(ValueError, match="no task"):
        bootstrap_over_tasks([], rng=rng)
