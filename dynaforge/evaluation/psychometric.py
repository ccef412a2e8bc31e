"""Psychometric curves: success as it falls with speed, and the critical speed at which it is one half."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynaforge.evaluation.statistics import Interval
from dynaforge.geometry import Array

NEVER_FALLS = "never falls"
"""Named result: success is above one half up to the end of the range."""
NEVER_REACHES = "never reaches"
"""Named result: success is below one half from the start of the range."""

_ITERATIONS = 60
# Weak normal priors, as Wichmann and Hill put on the lapse: (mean, standard deviation) of the ceiling's logit, of the
# midpoint in units of the range (from 0 to 1), and of the logarithm of the slope, per range.
_MEAN, _SD = np.array([2.0, 0.5, math.log(8.0)]), np.array([2.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class PsychometricCurve:
    """Success against speed, or any other difficulty: a falling logistic curve below a free ceiling,

        p(x) = ceiling / (1 + exp((x - midpoint) / width)).

    The ceiling is what is reached at rest: 1 minus the lapses, failures that have nothing to do with speed (Wichmann
    and Hill, "The psychometric function", Percept. Psychophys. 63:1293 and 63:1314, 2001). The fit is the mode with
    weak normal priors on its three numbers, so that it exists where no attempt, or every attempt, succeeds.

    Attributes:
        ceiling: Success far below the midpoint.
        midpoint: Where success is half of the ceiling, in the unit of x.
        width: Over which it falls, in the unit of x, above 0.
        span: Lowest and highest x of the task: nothing is said about what lies outside.
        interval: 95 % percentile interval of `crossing`, bootstrap over conditions; its ends are infinite where the
            crossing of a resample lies outside the span.
    """

    ceiling: float
    midpoint: float
    width: float
    span: tuple[float, float]
    interval: Interval

    def at(self, x: ArrayLike) -> Array:
        """Return success at x, of any shape."""
        z = (np.asarray(x, dtype=float) - self.midpoint) / self.width
        result: Array = self.ceiling * _sigmoid(-z)
        return result

    @property
    def crossing(self) -> float:
        """Where success is one half; infinity where it never falls so far, minus infinity where it is never so high."""
        parameters = np.array([[self.ceiling, self.midpoint, self.width]])
        return float(_crossings(parameters, *self.span)[0])

    @property
    def critical(self) -> float | str:
        """Where success is one half, the critical speed; `NEVER_FALLS` or `NEVER_REACHES` if not within the span."""
        return named(self.crossing)

    def describe(self, digits: int = 2) -> str:
        """Return the critical speed and its interval in words, e.g. "0.62 [0.55, never falls]"."""
        low, high = (_words(named(end), digits) for end in self.interval)
        value = _words(self.critical, digits)
        return value if value == low == high else f"{value} [{low}, {high}]"

    def to_dict(self) -> dict[str, Any]:
        """Return the curve as plain JSON data; numbers that are none are given by their names."""
        return {
            "ceiling": self.ceiling,
            "midpoint": self.midpoint,
            "width": self.width,
            "span": list(self.span),
            "critical": self.critical,
            "interval": [named(end) for end in self.interval],
        }


def fit_curve(
    x: ArrayLike,
    success: ArrayLike,
    *,
    span: tuple[float, float],
    rng: np.random.Generator,
    resamples: int = 1000,
    confidence: float = 0.95,
) -> PsychometricCurve:
    """Fit the curve of a generator on a task.

    Args:
        x: Speed, or difficulty, of each condition, shape (n,).
        success: Success on each, shape (n,).
        span: Lowest and highest x of the task.
        rng: What the bootstrap draws from.
        resamples: Number of resamples of the conditions.
        confidence: Two-sided confidence of the interval.

    Raises:
        ValueError: No attempts, shapes that differ, outcomes other than success and failure, or an empty span.
    """
    places, outcomes = np.asarray(x, dtype=float), np.asarray(success, dtype=float)
    low, high = span
    if places.shape != outcomes.shape or places.ndim != 1 or not places.size:
        raise ValueError(f"A curve needs two equal, non-empty vectors; given {places.shape} and {outcomes.shape}.")
    if not np.all((outcomes == 0) | (outcomes == 1)):
        raise ValueError("Outcomes must be success (1, True) or failure (0, False).")
    if not low < high:
        raise ValueError(f"The span ({low:g}, {high:g}) of a curve is empty.")
    n = len(places)
    places = (places - low) / (high - low)
    best_fit = _fit(_MEAN, places, outcomes, np.ones((1, n)))
    weights = rng.multinomial(n, np.full(n, 1 / n), size=resamples).astype(float)
    fitted = np.concatenate((best_fit, _fit(best_fit[0], places, outcomes, weights)))
    ceiling, midpoint, width = (_sigmoid(fitted[:, 0]), fitted[:, 1], np.exp(-fitted[:, 2]))
    parameters = np.stack((ceiling, low + (high - low) * midpoint, (high - low) * width), axis=1)
    crossings, tail = np.sort(_crossings(parameters[1:], low, high)), (1 - confidence) / 2
    ends = (math.floor(tail * (resamples - 1)), math.ceil((1 - tail) * (resamples - 1)))
    best = parameters[0].tolist()
    interval = Interval(*(float(crossings[end]) for end in ends)) if resamples else Interval(-math.inf, math.inf)
    return PsychometricCurve(ceiling=best[0], midpoint=best[1], width=best[2], span=(low, high), interval=interval)


def named(crossing: float) -> float | str:
    """Return a crossing, or the name of what it is where it is infinite."""
    if math.isinf(crossing):
        return NEVER_FALLS if crossing > 0 else NEVER_REACHES
    return crossing


def _words(value: float | str, digits: int) -> str:
    return value if isinstance(value, str) else f"{value:.{digits}f}"


def _crossings(parameters: Array, low: float, high: float) -> Array:
    """Return where curves are at one half, shape (B,); infinite where that is not between low and high.

    Args:
        parameters: Ceiling, midpoint and width of each curve, shape (B, 3).
        low: Start of the span.
        high: End of the span.
    """
    ceiling, midpoint, width = parameters.T
    reaches = 2.0 * ceiling - 1.0
    where = midpoint + width * np.log(np.where(reaches > 0.0, reaches, 1.0))
    where = np.where((reaches <= 0.0) | (where < low), -np.inf, where)
    result: Array = np.where(where > high, np.inf, where)
    return result


def _fit(start: Array, x: Array, success: Array, weights: Array) -> Array:
    """Return the modes of many weighted fits, by damped Newton steps with the expected curvature.

    Args:
        start: Where each of them begins, shape (3,).
        x: Place of each condition in the span, 0 to 1, shape (n,).
        success: Shape (n,).
        weights: How often each condition counts in each fit, shape (B, n).

    Returns:
        Logit of the ceiling, midpoint and logarithm of the slope of each fit, shape (B, 3).
    """
    at = np.tile(start, (len(weights), 1))
    value = _log_posterior(at, x, success, weights)
    damping = np.full(len(weights), 1e-2)
    for _ in range(_ITERATIONS):
        gradient, curvature = _derivatives(at, x, success, weights)
        scale = np.eye(3) * (damping[:, None, None] * np.einsum("bii->bi", curvature)[:, None, :])
        trial = at + np.linalg.solve(curvature + scale, gradient[..., None])[..., 0]
        trial_value = _log_posterior(trial, x, success, weights)
        better = trial_value >= value
        moved = np.abs(trial - at).max(axis=1) > 1e-5
        at, value = np.where(better[:, None], trial, at), np.where(better, trial_value, value)
        damping = np.where(better, damping / 5.0, damping * 10.0).clip(1e-8, 1e8)
        if not moved.any():
            break
    return at


def _model(at: Array, x: Array) -> tuple[Array, Array, Array, Array]:
    """Return ceiling (B, 1), logistic part (B, n), slope (B, 1) and offset from the midpoint (B, n) of each fit."""
    slope = np.exp(at[:, 2:3].clip(-20.0, 20.0))
    offset = x - at[:, 1:2]
    return _sigmoid(at[:, 0:1]), _sigmoid(-slope * offset), slope, offset


def _log_posterior(at: Array, x: Array, success: Array, weights: Array) -> Array:
    ceiling, falling, _, _ = _model(at, x)
    p = (ceiling * falling).clip(1e-12, 1.0 - 1e-12)
    likelihood = np.sum(weights * np.where(success > 0, np.log(p), np.log1p(-p)), axis=1)
    result: Array = likelihood - 0.5 * np.sum(((at - _MEAN) / _SD) ** 2, axis=1)
    return result


def _derivatives(at: Array, x: Array, success: Array, weights: Array) -> tuple[Array, Array]:
    """Return gradient (B, 3) and expected negative curvature (B, 3, 3) of the logarithm of the posterior."""
    ceiling, falling, slope, offset = _model(at, x)
    p = (ceiling * falling).clip(1e-12, 1.0 - 1e-12)
    by_logit = (1.0 - falling) * p * slope  # of p by the midpoint
    jacobian = np.stack((p * (1.0 - ceiling), by_logit, -by_logit * offset), axis=-1)  # (B, n, 3)
    information = weights / (p * (1.0 - p))
    gradient = np.einsum("bn,bnk->bk", information * (success - p), jacobian) - (at - _MEAN) / _SD**2
    curvature = np.einsum("bn,bnk,bnl->bkl", information, jacobian, jacobian, optimize=True)
    return gradient, curvature + np.diag(1.0 / _SD**2)


def _sigmoid(z: Array) -> Array:
    result: Array = 0.5 * (1.0 + np.tanh(0.5 * z))
    return result
