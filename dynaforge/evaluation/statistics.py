"""Intervals and tests for success rates: Wilson, McNemar, Newcombe, and a bootstrap over seeds and conditions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaforge.geometry import Array


class Interval(NamedTuple):
    """A confidence interval."""

    low: float
    high: float


def wilson_bounds(successes: ArrayLike, n: ArrayLike, *, confidence: float = 0.95) -> tuple[Array, Array]:
    """Return the lower and upper Wilson score bounds of success rates, element by element.

    Without trials the bounds are (0, 1), because nothing is known.

    Args:
        successes: Counts, 0 <= successes <= n.
        n: Numbers of trials, of equal or broadcastable shape.
        confidence: Two-sided confidence.

    Raises:
        ValueError: Counts out of range, or a confidence outside (0, 1).
    """
    k, trials = np.broadcast_arrays(np.asarray(successes, dtype=float), np.asarray(n, dtype=float))
    if np.any(k < 0) or np.any(k > trials):
        raise ValueError("Successes must lie between 0 and the number of trials.")
    z = _quantile(confidence)
    some = np.maximum(trials, 1.0)
    rate, shrink = k / some, 1.0 + z**2 / some
    centre = (rate + z**2 / (2 * some)) / shrink
    half = z * np.sqrt(rate * (1 - rate) / some + z**2 / (4 * some**2)) / shrink
    # For k = 0 and k = n one bound is exactly 0 or 1, which rounding would miss.
    low = np.where(k == 0, 0.0, centre - half)
    high = np.where(k == trials, 1.0, centre + half)
    return low, high


def wilson_interval(successes: int, n: int, *, confidence: float = 0.95) -> Interval:
    """Return the Wilson score interval of one success rate; (0, 1) for n = 0.

    Args:
        successes: Number of successes.
        n: Number of trials.
        confidence: Two-sided confidence.

    Raises:
        ValueError: As `wilson_bounds`.
    """
    low, high = wilson_bounds(successes, n, confidence=confidence)
    return Interval(float(low), float(high))


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedDifference:
    """Two generators on the same conditions.

    Attributes:
        n: Number of pairs.
        both, only_a, only_b, neither: On how many conditions both, only one, or neither of them succeeded.
        difference: Success rate of b minus that of a.
        interval: Newcombe's hybrid score interval of the difference (his method 10).
        p_value: Exact two-sided McNemar test of "no difference".
    """

    n: int
    both: int
    only_a: int
    only_b: int
    neither: int
    difference: float
    interval: Interval
    p_value: float


def paired_difference(a: ArrayLike, b: ArrayLike, *, confidence: float = 0.95) -> PairedDifference:
    """Compare two generators condition by condition: how much better is b than a?

    The p value is McNemar's exact test: under no difference the discordant pairs fall to either side with
    probability one half. The interval is Newcombe's (1998, Stat. Med. 17:2635, method 10): the Wilson limits of both
    rates, joined by square-and-add with the continuity-corrected correlation phi. It stays inside [-1, 1] and has
    sound coverage where the Wald interval fails (few or no discordant pairs).

    Args:
        a: Success of the first generator on each condition, shape (n,).
        b: Success of the second one on the same conditions, shape (n,).
        confidence: Two-sided confidence of the interval.

    Raises:
        ValueError: Unequal lengths, no conditions, or values other than success and failure.
    """
    first, second = _outcomes(a), _outcomes(b)
    if first.shape != second.shape or first.ndim != 1 or not first.size:
        raise ValueError(f"Pairs need two equal, non-empty vectors; given {first.shape} and {second.shape}.")
    both = int(np.sum(first & second))
    only_a = int(np.sum(first & ~second))
    only_b = int(np.sum(~first & second))
    n = first.size
    neither = n - both - only_a - only_b
    return PairedDifference(
        n=n,
        both=both,
        only_a=only_a,
        only_b=only_b,
        neither=neither,
        difference=(only_b - only_a) / n,
        interval=_newcombe(both, only_b, only_a, neither, confidence=confidence),
        p_value=mcnemar_exact(only_a, only_b),
    )


def mcnemar_exact(only_a: int, only_b: int) -> float:
    """Return the exact two-sided McNemar p value of the two discordant counts; 1 when there are none."""
    n, fewer = only_a + only_b, min(only_a, only_b)
    tail = sum(math.comb(n, k) for k in range(fewer + 1))
    return min(1.0, float(2 * tail / 2**n))


def _newcombe(both: int, only_after: int, only_before: int, neither: int, *, confidence: float) -> Interval:
    """Return Newcombe's interval of the rate after minus the rate before, from the four counts of pairs."""
    n = both + only_after + only_before + neither
    k_after, k_before = both + only_after, both + only_before
    after, before = k_after / n, k_before / n
    low_after, high_after = wilson_interval(k_after, n, confidence=confidence)
    low_before, high_before = wilson_interval(k_before, n, confidence=confidence)
    product = float(both * neither - only_after * only_before)
    if product > 0:
        product = max(product - n / 2, 0.0)  # the continuity correction of method 10
    margins = k_after * (n - k_after) * k_before * (n - k_before)
    phi = product / math.sqrt(margins) if margins else 0.0

    def distance(x: float, y: float) -> float:
        return math.sqrt(max(x**2 - 2 * phi * x * y + y**2, 0.0))

    difference = after - before
    low = difference - distance(after - low_after, high_before - before)
    high = difference + distance(high_after - after, before - low_before)
    return Interval(low, high)


@dataclass(frozen=True, slots=True)
class BootstrapDifference:
    """Difference of two training algorithms with its bootstrap interval.

    Attributes:
        difference: Success rate of b minus that of a, mean over tasks.
        interval: Percentile interval of the difference.
        resamples: Number of resamples.
    """

    difference: float
    interval: Interval
    resamples: int


def bootstrap_over_tasks(
    pairs: Sequence[tuple[ArrayLike, ArrayLike]],
    *,
    rng: np.random.Generator,
    resamples: int = 10_000,
    confidence: float = 0.95,
) -> BootstrapDifference:
    """Compare two training algorithms by the mean over tasks of their difference in success rate.

    Tasks are not resampled. Within a task, training seeds are resampled for each algorithm separately, and conditions
    for both together since they are shared. The interval is the percentile interval.

    Args:
        pairs: For each task (a, b), success of training seed s on condition c, shapes (S_a, C) and (S_b, C).
        rng: What the resampling draws from.
        resamples: Number of resamples.
        confidence: Two-sided confidence of the interval.

    Raises:
        ValueError: No task, the shapes do not fit, or the outcomes are not binary.
    """
    if not pairs:
        raise ValueError("There is no task to compare on.")
    differences, draws = [], np.zeros(resamples)
    for a, b in pairs:
        first, second = check_runs(a, b)
        conditions = _weights(first.shape[1], resamples, rng)
        rates = [
            np.sum((_weights(len(outcomes), resamples, rng) @ outcomes) * conditions, axis=1)
            for outcomes in (first, second)
        ]
        draws += (rates[1] - rates[0]) / len(pairs)
        differences.append(second.mean() - first.mean())
    tail = (1 - confidence) / 2
    ends = np.quantile(draws, [tail, 1 - tail])
    return BootstrapDifference(float(np.mean(differences)), Interval(float(ends[0]), float(ends[1])), resamples)


def check_runs(a: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
    """Return the outcomes of two algorithms on a task as numbers, success of seed s on condition c.

    Args:
        a: Outcomes, shape (S_a, C).
        b: Outcomes on the same conditions, shape (S_b, C).

    Raises:
        ValueError: The shapes do not fit, or the outcomes are not binary.
    """
    first, second = _outcomes(a).astype(float), _outcomes(b).astype(float)
    if first.ndim != 2 or second.ndim != 2 or first.shape[1] != second.shape[1] or not (first.size and second.size):
        raise ValueError(f"Expected (S_a, C) and (S_b, C) with equal C; given {first.shape} and {second.shape}.")
    return first, second


def _weights(n: int, resamples: int, rng: np.random.Generator) -> Array:
    """Return how often each of n items is drawn in a resample, as a share, shape (resamples, n)."""
    return np.asarray(rng.multinomial(n, np.full(n, 1 / n), size=resamples) / n)


@dataclass(frozen=True, slots=True)
class BinComparison:
    """A change, judged in each difficulty bin.

    Attributes:
        bins: Paired difference (after minus before) of each bin, easiest first.
        worse: Indices of the bins that are worse beyond the margin: their whole interval lies below minus it.
    """

    bins: tuple[PairedDifference, ...]
    worse: tuple[int, ...]

    @property
    def holds(self) -> bool:
        """True if no bin is worse."""
        return not self.worse


def no_bin_worse(
    before: Sequence[ArrayLike] | ArrayLike,
    after: Sequence[ArrayLike] | ArrayLike,
    *,
    margin: float = 0.10,
    confidence: float = 0.95,
) -> BinComparison:
    """Check that no difficulty bin is worse: none has the whole interval of its difference below minus the margin.

    Args:
        before: Success by condition, one row per bin, shape (8, 100) by the protocol; rows may differ in length.
        after: Success on the same conditions.
        margin: By how much a bin may be worse, as a rate; 10 points by default.
        confidence: Two-sided confidence of the intervals.

    Raises:
        ValueError: Rows do not pair up.
    """
    rows_before, rows_after = list(before), list(after)  # type: ignore[arg-type]
    if len(rows_before) != len(rows_after) or not rows_before:
        raise ValueError(f"Expected the same bins twice; given {len(rows_before)} and {len(rows_after)}.")
    pairs = zip(rows_before, rows_after, strict=True)
    bins = tuple(paired_difference(a, b, confidence=confidence) for a, b in pairs)
    worse = tuple(index for index, difference in enumerate(bins) if difference.interval.high < -margin)
    return BinComparison(bins, worse)


def _outcomes(values: ArrayLike) -> NDArray[np.bool_]:
    """Return outcomes as booleans, or refuse what is neither success nor failure."""
    array = np.asarray(values)
    if not np.all((array == 0) | (array == 1)):
        raise ValueError("Outcomes must be success (1, True) or failure (0, False).")
    return array.astype(bool)


def _quantile(confidence: float) -> float:
    """Return the quantile of the normal distribution for a two-sided confidence."""
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"Confidence must lie between 0 and 1, given {confidence}.")
    return NormalDist().inv_cdf(0.5 + confidence / 2)
