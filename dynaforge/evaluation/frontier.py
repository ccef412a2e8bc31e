"""Where the competence frontier stands during training (Eq. 10 of the paper, and its figure)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaforge.evaluation.statistics import wilson_bounds
from dynaforge.geometry import Array, one_line

WINDOW = 20  # updates in the trailing mean of success
SMOOTHING = 9  # updates in the trailing mean of the depth


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FrontierAnalysis:
    """Success of each stratum over a training run, and how deep the mastered ranks reach.

    U updates, N strata; strata are numbered as they were sampled, ranks are counted from the easiest.

    Attributes:
        success: Success fraction p_i(u) of each update, shape (U, N); NaN where a stratum had no trial.
        trailing: Eq. 10, its mean over the last `window` updates, shape (U, N); NaN before the first trial.
        order: Stratum at each rank, by descending mean success over the full run, shape (N,).
        depth: Number of contiguous ranks that are mastered, from the easiest on, shape (U,).
        frontier: Trailing mean of `depth` over the smoothing window, shape (U,).
    """

    success: Array
    trailing: Array
    order: NDArray[np.int64]
    depth: NDArray[np.int64]
    frontier: Array

    __repr__ = one_line

    @property
    def overall(self) -> Array:
        """Success fraction of each update, mean over the strata that were ever tried, shape (U,).

        A stratum that an update left out counts with its last known success: a curriculum leaves out those that
        always succeed or always fail, and the mean of the others would be that of the frontier alone.
        """
        return np.asarray(_mean(_last_known(self.success), axis=1))

    @property
    def overall_trailing(self) -> Array:
        """`overall` over the trailing window: the learning curve, shape (U,)."""
        return np.asarray(_mean(self.trailing, axis=1))


def analyse_frontier(
    successes: ArrayLike,
    trials: ArrayLike,
    *,
    window: int = WINDOW,
    smoothing: int = SMOOTHING,
    confidence: float = 0.95,
) -> FrontierAnalysis:
    """Find the competence frontier of a training run from the windowed success of Eq. 10.

    A stratum is mastered when the Wilson lower bound of its success is at least one half, over the outcomes pooled in
    the trailing window. The frontier is the deepest rank up to which all strata are mastered.

    Args:
        successes: Successful rollouts of each update and stratum, shape (U, N).
        trials: Rollouts made, broadcastable to (U, N): K, or an array where the strata differ.
        window: Updates in the trailing window over which outcomes are pooled; at the start, w_u = min(window, u).
        smoothing: Updates in the trailing mean of the depth, likewise.
        confidence: Confidence of the two-sided Wilson interval.

    Raises:
        ValueError: A wrong shape, counts out of range, or an empty window.
    """
    counts = np.asarray(successes, dtype=float)
    if counts.ndim != 2 or not counts.size:
        raise ValueError(f"Success counts must have shape (U, N), given {counts.shape}.")
    if window < 1 or smoothing < 1:
        raise ValueError(f"Windows must span at least one update, given {window} and {smoothing}.")
    made = np.broadcast_to(np.asarray(trials, dtype=float), counts.shape)
    tried = made > 0
    success = _ratio(counts, made)
    pooled_n = _trailing_sum(made, window)
    low, _ = wilson_bounds(_trailing_sum(counts, window), pooled_n, confidence=confidence)
    full_run = _mean(success, axis=0)
    order = np.argsort(-np.nan_to_num(full_run, nan=-1.0), kind="stable")  # among equals the lower stratum comes first
    mastered = (low >= 0.5)[:, order]
    depth = np.cumprod(mastered, axis=1).sum(axis=1)
    return FrontierAnalysis(
        success=success,
        trailing=_ratio(_trailing_sum(np.nan_to_num(success), window), _trailing_sum(tried, window)),
        order=order.astype(np.int64),
        depth=depth.astype(np.int64),
        frontier=trailing_mean(depth, smoothing),
    )


def trailing_mean(values: ArrayLike, window: int) -> Array:
    """Return the mean of each value and those before it, at most `window` of them, along the first axis."""
    array = np.asarray(values, dtype=float)
    return _ratio(_trailing_sum(array, window), _trailing_sum(np.ones_like(array), window))


def _trailing_sum(values: ArrayLike, window: int) -> Array:
    """Return the sum of each value and those before it, at most `window` of them, along the first axis."""
    array = np.asarray(values, dtype=float)
    total: Array = np.cumsum(array, axis=0)
    total[window:] -= total[:-window].copy()
    return total


def _last_known(values: Array) -> Array:
    """Replace NaN by the last number before it along the first axis, if there is one."""
    rows = np.where(np.isnan(values), 0, np.arange(len(values))[:, None])
    return np.asarray(np.take_along_axis(values, np.maximum.accumulate(rows, axis=0), axis=0))


def _ratio(numerator: Array, denominator: Array) -> Array:
    """Divide element by element; NaN where the denominator is 0."""
    return np.asarray(np.divide(numerator, denominator, out=np.full(numerator.shape, np.nan), where=denominator > 0))


def _mean(values: Array, *, axis: int) -> Array:
    """Return the mean without NaN along an axis; NaN where there is nothing else."""
    known = ~np.isnan(values)
    return _ratio(np.nan_to_num(values).sum(axis=axis), known.sum(axis=axis).astype(float))
