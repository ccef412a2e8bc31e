"""An interval for the difference of two training algorithms that holds with few training seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence

from numpy.typing import ArrayLike
from scipy.special import stdtrit  # type: ignore[import-untyped, unused-ignore]

from dynaforge.evaluation.statistics import Interval, check_runs
from dynaforge.geometry import Array


def few_seeds_interval(pairs: Sequence[tuple[ArrayLike, ArrayLike]], *, confidence: float = 0.95) -> Interval:
    """Return an interval for the mean over tasks of the difference in success rate, b minus a, by Student's t.

    A bootstrap of three training seeds knows of no others: where seeds spread by 8 points, its 95 % interval holds the
    difference of the algorithms in 86 to 89 % of cases. This one is Welch's for the seeds, with conditions as a second
    random factor that both algorithms share. On a task, the variance of the difference is, by the analysis of variance
    of two crossed factors without repetition,

        V = sum over a and b of (MS_seeds - MS_residual) / (S C)  +  var_c(d_c) / C,

    d_c being the difference on condition c, mean over seeds; MS_seeds / C is the variance of the seeds' rates. It is
    taken as no smaller than either source alone. Tasks are fixed, their variances add up, and the degrees of freedom
    are Satterthwaite's (1946).

    Args:
        pairs: For each task (a, b), success of training seed s on condition c, shapes (S_a, C) and (S_b, C).
        confidence: Two-sided confidence.

    Returns:
        The interval; infinite where some algorithm has one seed on a task, since nothing tells how far seeds spread.

    Raises:
        ValueError: No task, the shapes do not fit, the outcomes are not binary, or a confidence outside (0, 1).
    """
    if not pairs:
        raise ValueError("There is no task to compare on.")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"Confidence must lie between 0 and 1, given {confidence}.")
    difference = variance = by_freedom = 0.0
    for a, b in pairs:
        first, second = check_runs(a, b)
        difference += float(second.mean() - first.mean()) / len(pairs)
        if min(len(first), len(second), first.shape[1]) < 2:
            return Interval(-math.inf, math.inf)
        (seeds_a, residual_a), (seeds_b, residual_b) = _of_seeds(first), _of_seeds(second)
        parts = [seeds_a, seeds_b, residual_a, residual_b, _of_conditions(first, second)]
        seeds, residual, conditions = seeds_a[0] + seeds_b[0], residual_a[0] + residual_b[0], parts[-1][0]
        variance += max(seeds + conditions - residual, seeds, conditions) / len(pairs) ** 2
        by_freedom += sum(v**2 / freedom for v, freedom in parts) / len(pairs) ** 4
    if variance == 0.0:
        return Interval(difference, difference)
    half = float(stdtrit(variance**2 / by_freedom, 0.5 + confidence / 2)) * math.sqrt(variance)
    return Interval(difference - half, difference + half)


def _of_seeds(outcomes: Array) -> tuple[tuple[float, int], tuple[float, int]]:
    """Return MS_seeds / (S C) and MS_residual / (S C) of one algorithm, with their degrees of freedom."""
    n_seeds, n_conditions = outcomes.shape
    by_seed, by_condition = outcomes.mean(axis=1, keepdims=True), outcomes.mean(axis=0, keepdims=True)
    residual = outcomes - by_seed - by_condition + outcomes.mean()
    freedom = (n_seeds - 1) * (n_conditions - 1)
    residual_share = float((residual**2).sum()) / freedom / outcomes.size
    return (float(by_seed.var(ddof=1)) / n_seeds, n_seeds - 1), (residual_share, freedom)


def _of_conditions(first: Array, second: Array) -> tuple[float, int]:
    """Return var_c(d_c) / C with its degrees of freedom."""
    by_condition = second.mean(axis=0) - first.mean(axis=0)
    n = len(by_condition)
    return float(by_condition.var(ddof=1)) / n, n - 1
