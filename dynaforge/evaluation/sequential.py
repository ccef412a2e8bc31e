"""A test of success that may be looked at after every attempt: a comparison ends as soon as it is decided.

A fixed-sample test that is repeated after every attempt errs far more often than its level says. Here a gambler bets
against "the mean is m" with a capital of 1, and whatever the outcomes' order, the capital is a test martingale if m is
the mean: by Ville's inequality it ever reaches 1 / level with probability `level` at most. Whoever stops then, or at
any other time, for any reason, errs no more often than that.

The bets are those of the hedged grid Kelly bettor of Waudby-Smith and Ramdas, "Estimating means of bounded random
variables by betting" (J. R. Stat. Soc. B 86:1, 2024; arXiv 2010.09686). With outcomes x in [0, 1],

    K_t(m) = 1 / 2G * sum_g [ prod_i (1 + f_g (x_i - m) / m)  +  prod_i (1 - f_g (x_i - m) / (1 - m)) ],

f_g = g / (G + 1), a mixture of constant bets in both directions, which needs no tuning. The means m that it does not
refute, K_t(m) < 1 / level, are a confidence sequence: with probability 1 - level it holds the mean at all times.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dynaforge.evaluation.statistics import Interval
from dynaforge.geometry import Array

LEVEL = 0.05
"""Probability of a wrong decision, if there is no difference, over all times at which one may look."""

_BETS = np.arange(1, 21) / 21.0  # f_g
_MOST = 700.0  # logarithm of the greatest capital that is told
_HALVINGS = 40  # of the bracket around an end of the interval


class SequentialTest:
    """Bets against a mean, outcome by outcome.

    Args:
        null: The mean that is tested.
        bounds: Least and greatest value that an outcome can have: (-1, 1) for paired differences, (0, 1) for success.
        level: Probability of ever refuting the null where it is true.

    Raises:
        ValueError: A null outside its bounds, or a level outside (0, 1).
    """

    def __init__(self, null: float = 0.0, *, bounds: tuple[float, float] = (-1.0, 1.0), level: float = LEVEL) -> None:
        low, high = bounds
        if not low < null < high:
            raise ValueError(f"The tested mean must lie inside ({low:g}, {high:g}), given {null}.")
        if not 0.0 < level < 1.0:
            raise ValueError(f"A level must lie between 0 and 1, given {level}.")
        self.level, self._low, self._span = level, low, high - low
        self._null = (null - low) / self._span
        self._bets = np.zeros(2 * len(_BETS))  # logarithm of what each bet against the null has made of 1
        self._counts: Counter[float] = Counter()  # of the outcomes in [0, 1]; the capital does not see their order
        self.decided = False

    @property
    def n(self) -> int:
        """Number of outcomes so far."""
        return self._counts.total()

    @property
    def mean(self) -> float:
        """Mean of the outcomes so far; NaN before the first."""
        total = sum(value * count for value, count in self._counts.items())
        return self._low + self._span * total / self.n if self.n else math.nan

    @property
    def e_value(self) -> float:
        """The capital that the bets against the null have made of 1; the inverse of it is an upper bound of p."""
        return math.exp(min(_log_mean(self._bets), _MOST))

    @property
    def interval(self) -> Interval:
        """The means that are not refuted, an interval of confidence 1 - level at whatever time it is looked at."""
        if not self.n:
            return Interval(self._low, self._low + self._span)
        # Every product is convex in m, and at most 1 at the outcomes' mean: what is kept is an interval around it.
        mean = (self.mean - self._low) / self._span
        ends = (self._low + self._span * self._last_kept(mean, end) for end in (0.0, 1.0))
        return Interval(*ends)

    def push(self, outcome: float) -> bool:
        """Take in an outcome, and return whether the null is refuted, by this one or by an earlier one.

        Raises:
            ValueError: It is out of bounds.
        """
        value = (float(outcome) - self._low) / self._span
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"An outcome must lie in [{self._low:g}, {self._low + self._span:g}], given {outcome}.")
        self._counts[value] += 1
        self._bets += _log_factors(value, self._null)
        self.decided = self.decided or _log_mean(self._bets) >= -math.log(self.level)
        return self.decided

    def _last_kept(self, mean: float, end: float) -> float:
        """Return how far from the mean of the outcomes toward 0 or 1 means are not refuted, by bisection."""
        kept, refuted = mean, end
        for _ in range(_HALVINGS):
            middle = (kept + refuted) / 2.0
            if middle in (0.0, 1.0):
                break
            bets = [count * _log_factors(value, middle) for value, count in self._counts.items()]
            if _log_mean(np.sum(bets, axis=0)) < -math.log(self.level):
                kept = middle
            else:
                refuted = middle
        return refuted


@dataclass(frozen=True, slots=True)
class SequentialComparison:
    """Where a comparison of two generators could be ended.

    Attributes:
        n: Number of conditions that were looked at: those up to the decision, or all.
        available: Number of conditions that there are.
        decided: Whether the difference was found to be other than zero.
        difference: Success rate of b minus that of a on the n conditions; it is too large where it ended early.
        interval: Of the difference, as `SequentialTest.interval`; it holds in spite of the early end.
        e_value: The evidence against "no difference".
        level: As in `SequentialTest`.
    """

    n: int
    available: int
    decided: bool
    difference: float
    interval: Interval
    e_value: float
    level: float

    @property
    def saved(self) -> int:
        """Number of conditions that were not needed."""
        return self.available - self.n

    def describe(self) -> str:
        """Return in one line where it ended."""
        low, high = (100 * end for end in self.interval)
        verdict = "decided after" if self.decided else "not decided by"
        return (
            f"{verdict} {self.n} of {self.available} conditions (anytime-valid test, level {100 * self.level:g} %), "
            f"{100 * self.saved / self.available:.0f} % saved; difference {100 * (1 - self.level):g} % "
            f"[{low:+.1f}, {high:+.1f}]"
        )


def sequential_difference(
    a: ArrayLike, b: ArrayLike, *, available: int | None = None, level: float = LEVEL
) -> SequentialComparison:
    """Compare two generators condition by condition until it is decided which succeeds more often.

    The tested hypothesis is that both are equally likely to succeed on every condition; pairs on which both agree bet
    nothing. Where the i-th conditions of a and b are not the same but drawn alike, this is a test of one rate against
    another.

    Args:
        a: Success of the first generator on each condition, in the order in which they are attempted, shape (n,).
        b: Success of the second one, likewise; what comes after the shorter of the two is not looked at.
        available: Number of conditions that there would be; by default those given.
        level: Probability of deciding, ever, if there is no difference.

    Raises:
        ValueError: No outcomes, or values other than success and failure.
    """
    first, second = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    n = min(len(first), len(second))
    if not n or not np.all(np.isin(np.concatenate((first, second)), (0.0, 1.0))):
        raise ValueError("A comparison needs outcomes that are success (1, True) or failure (0, False).")
    test = _run(SequentialTest(level=level), second[:n] - first[:n])
    return _comparison(test, n if available is None else available)


def sequential_rate(outcomes: ArrayLike, rate: float, *, level: float = LEVEL) -> SequentialComparison:
    """Compare a generator with a given rate of success, attempt by attempt, until it is decided which is greater.

    Args:
        outcomes: Success of each attempt, in order, shape (n,).
        rate: The rate, inside (0, 1).
        level: Probability of deciding, ever, if the generator has just this rate.

    Returns:
        The comparison; its difference and interval are those of the generator's rate minus the given one.

    Raises:
        ValueError: No outcomes, values other than success and failure, or a rate outside (0, 1).
    """
    success = np.asarray(outcomes, dtype=float)
    if not success.size or not np.all(np.isin(success, (0.0, 1.0))):
        raise ValueError("A comparison needs outcomes that are success (1, True) or failure (0, False).")
    test = SequentialTest(bounds=(-rate, 1.0 - rate), level=level)
    return _comparison(_run(test, success - rate), len(success))


@functools.lru_cache(maxsize=512)
def _log_factors(value: float, m: float) -> Array:
    """Return the logarithm of the factor by which an outcome multiplies each bet against a mean in (0, 1)."""
    return np.log1p(np.concatenate((_BETS * (value - m) / m, -_BETS * (value - m) / (1.0 - m))))


def _log_mean(logarithms: Array) -> float:
    """Return the logarithm of the mean of what has these logarithms."""
    most = float(logarithms.max())
    return most + math.log(float(np.exp(logarithms - most).mean()))


def _run(test: SequentialTest, outcomes: Iterable[float]) -> SequentialTest:
    for outcome in outcomes:
        if test.push(outcome):
            break
    return test


def _comparison(test: SequentialTest, available: int) -> SequentialComparison:
    return SequentialComparison(test.n, available, test.decided, test.mean, test.interval, test.e_value, test.level)
