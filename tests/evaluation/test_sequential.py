from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from dynaforge.evaluation.sequential import SequentialTest, sequential_difference, sequential_rate


def outcomes(only_a: float, only_b: float, *, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Success of two generators on n conditions, of which a share falls to one of them only, the rest to both."""
    drawn = rng.random(n)
    return drawn >= only_b, (drawn < only_b) | (drawn >= only_a + only_b)


def test_the_capital_is_that_of_the_bets_worked_by_hand() -> None:
    test = SequentialTest()
    assert (test.n, test.e_value, test.decided) == (0, 1.0, False)
    assert math.isnan(test.mean)
    test.push(1.0)
    assert test.e_value == pytest.approx(1.0)  # both directions bet alike, so the first pair wins nothing
    test.push(1.0)
    # The mean over f of ((1 + f)^2 + (1 - f)^2) / 2 = 1 + f^2, f = 1/21 ... 20/21: 1 + (20 * 21 * 41 / 6) / 21^2 / 20
    assert test.e_value == pytest.approx(1.0 + 2870 / 441 / 20)
    test.push(0.0)  # on which both agree
    assert test.e_value == pytest.approx(1.0 + 2870 / 441 / 20)
    test.push(-1.0)
    # ... of ((1 + f)^2 (1 - f) + (1 - f)^2 (1 + f)) / 2 = 1 - f^2
    assert test.e_value == pytest.approx(1.0 - 2870 / 441 / 20)
    assert test.mean == pytest.approx(0.25)


def test_the_expected_capital_never_exceeds_one_where_the_null_is_true() -> None:
    """Over all sequences of six outcomes: a test martingale, for a fair coin and for a rate of 0.3."""
    for rate in (0.5, 0.3):
        total = 0.0
        for sequence in itertools.product((0, 1), repeat=6):
            test = SequentialTest(rate, bounds=(0.0, 1.0))
            for outcome in sequence:
                test.push(outcome)
            total += test.e_value * math.prod(rate if outcome else 1 - rate for outcome in sequence)
        assert total == pytest.approx(1.0)


@pytest.mark.parametrize("discordant", [1.0, 0.3])
def test_it_seldom_decides_where_there_is_no_difference_however_often_it_is_looked_at(discordant: float) -> None:
    rng = np.random.default_rng(0)
    made = [sequential_difference(*outcomes(discordant / 2, discordant / 2, n=150, rng=rng)) for _ in range(400)]
    wrong = sum(comparison.decided for comparison in made)
    assert 0 < wrong <= 20 + 2.5 * math.sqrt(400 * 0.05 * 0.95)


def test_it_decides_early_where_the_difference_is_large() -> None:
    rng = np.random.default_rng(1)
    made = [sequential_difference(*outcomes(0.05, 0.35, n=300, rng=rng)) for _ in range(100)]
    assert all(comparison.decided and comparison.difference > 0 for comparison in made)
    assert np.median([comparison.n for comparison in made]) < 80
    assert all(comparison.n + comparison.saved == 300 for comparison in made)
    small = [sequential_difference(*outcomes(0.10, 0.20, n=300, rng=rng)).decided for _ in range(100)]
    assert sum(small) >= 40  # ten points of three hundred; McNemar at the end would see about 70


def test_its_interval_holds_the_difference_at_the_time_at_which_it_ends() -> None:
    rng = np.random.default_rng(2)
    made = [sequential_difference(*outcomes(0.1, 0.3, n=200, rng=rng)) for _ in range(150)]
    missed = sum(not low <= 0.2 <= high for low, high in (comparison.interval for comparison in made))
    assert missed <= 7.5 + 2.5 * math.sqrt(150 * 0.05 * 0.95)
    assert all((comparison.interval.low > 0) == comparison.decided for comparison in made)
    assert all(comparison.interval.low <= comparison.difference <= comparison.interval.high for comparison in made)


def test_its_interval_is_symmetric_and_narrows() -> None:
    a, b = outcomes(0.1, 0.3, n=200, rng=np.random.default_rng(3))
    forth, back = (SequentialTest() for _ in range(2))
    widths = []
    for first, second in zip(a, b, strict=True):
        forth.push(float(second) - float(first))
        back.push(float(first) - float(second))
        widths.append(forth.interval.high - forth.interval.low)
    assert forth.interval == pytest.approx((-back.interval.high, -back.interval.low))
    assert widths[0] > 1.9
    assert widths[-1] < 0.4


def test_a_rate_is_compared_with_another_one() -> None:
    high = sequential_rate([1] * 30, 0.5)
    # All thirty succeed: decided when the mean over f of (1 + f)^n, halved, reaches 20, which takes eight of them.
    capital = [np.mean((1 + np.arange(1, 21) / 21) ** n + (1 - np.arange(1, 21) / 21) ** n) / 2 for n in range(31)]
    assert high.n == next(n for n in range(31) if capital[n] >= 20) == 8
    assert high.decided
    assert high.difference == pytest.approx(0.5)
    assert high.interval.high == pytest.approx(0.5)
    rng = np.random.default_rng(4)
    wrong = sum(sequential_rate(rng.random(120) < 0.3, 0.3).decided for _ in range(300))
    assert wrong <= 15 + 2.5 * math.sqrt(300 * 0.05 * 0.95)
    low = sequential_rate(rng.random(200) < 0.1, 0.3)
    assert low.decided
    assert low.difference < 0


def test_the_order_does_not_change_the_evidence_but_a_decision_stands() -> None:
    test = SequentialTest()
    for _ in range(12):
        test.push(1.0)
    assert test.decided
    for _ in range(12):
        test.push(-1.0)
    assert test.decided
    assert test.e_value < 1.0


def test_what_cannot_be_tested_is_refused() -> None:
    with pytest.raises(ValueError, match="inside"):
        SequentialTest(1.0, bounds=(0.0, 1.0))
    with pytest.raises(ValueError, match="level"):
        SequentialTest(level=0.0)
    with pytest.raises(ValueError, match=r"must lie in \[-1, 1\]"):
        SequentialTest().push(1.5)
    for a, b in (([], []), ([0.5], [1])):
        with pytest.raises(ValueError, match="success"):
            sequential_difference(a, b)
    with pytest.raises(ValueError, match="inside"):
        sequential_rate([1], 1.0)
