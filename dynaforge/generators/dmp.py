"""A dynamic movement primitive: a path whose shape was learned from one demonstration, and whose goal may move.

The settings are those of the script that DynaMimicGen's authors run, which differ from the defaults of their classes.
Time is the share s of the segment that has passed, so that tau is 1:

    x' = -DECAY x                                           canonical system
    y'' = alpha (alpha / 4 (g - y) - y') + D f(x)           transformation system
    f(x) = x sum_i w_i psi_i(x) / sum_i psi_i(x)            psi_i(x) = exp(-h_i (x - c_i)^2)
"""

from __future__ import annotations

import math

import numpy as np

from dynaforge.geometry import Array

DECAY = -math.log(1e-4)
"""alpha_x: x falls from 1 to 1e-4 in a segment."""
ALPHA, STIFF_ALPHA = 25.0, 50.0
STIFF_FROM = 0.5
"""Share of a segment after which `STIFF_ALPHA` takes the place of `ALPHA`."""
CENTRES: Array = np.exp(-DECAY * np.linspace(0.0, 1.0, 100))
WIDTHS: Array = 1.0 / np.gradient(CENTRES) ** 2
MIN_SAMPLES = 3  # of a path: its second derivative is a difference of differences


class MovementPrimitive:
    """A dynamic movement primitive of a path, one step a sample, so that it always lasts as long as the path.

    D = diag(g - y0) of the path, and stays so wherever the movement starts and ends. Where y0 and g of the path are
    equal, D is 0: in this dimension the movement goes to its goal and has no shape. Within a step, goal and forcing
    term are constant and the differential equation is solved exactly: the Euler step of the released code diverges in
    segments of less than 31 steps, which the authors' have not and ours have.

    Args:
        path: The path, shape (T, d), of any units.

    Raises:
        ValueError: The path has fewer than three samples, or a value that is not finite.
    """

    def __init__(self, path: Array) -> None:
        path = np.asarray(path, dtype=np.float64)
        if path.ndim != 2 or len(path) < MIN_SAMPLES or not np.isfinite(path).all():
            raise ValueError(
                f"A path is T x d finite numbers with T of {MIN_SAMPLES} or more; given shape {path.shape}."
            )
        self.n_steps = n = len(path)
        self.start_of_path, self.end_of_path = path[0].copy(), path[-1].copy()
        self.scale = self.end_of_path - self.start_of_path  # the diagonal of D
        velocity = np.gradient(path, axis=0) * n
        acceleration = np.gradient(velocity, axis=0) * n
        forcing = acceleration - ALPHA * (ALPHA / 4.0 * (self.end_of_path - path) - velocity)
        shaped = np.divide(forcing, self.scale, out=np.zeros_like(forcing), where=self.scale != 0.0)
        self._features = features(canonical(n))
        self.weights: Array = np.linalg.lstsq(self._features, shaped, rcond=None)[0]  # (100, d)
        self.restart(self.start_of_path)

    def restart(self, start: Array) -> None:
        """Begin at a place, at rest.

        Args:
            start: Where, shape (d,).
        """
        self.position = np.array(start, dtype=np.float64)
        self.velocity = np.zeros_like(self.position)
        self.steps = 0

    def step(self, goal: Array) -> Array:
        """Take one step toward a goal, and return where it leads, shape (d,).

        Args:
            goal: Where the movement shall end, as it is known now, shape (d,).

        Raises:
            RuntimeError: The movement has ended.
        """
        if self.steps == self.n_steps:
            raise RuntimeError(f"The movement has ended after {self.n_steps} steps; call restart().")
        alpha = STIFF_ALPHA if self.steps > STIFF_FROM * self.n_steps else ALPHA
        pull = self.scale * (self._features[self.steps] @ self.weights)
        rate, dt = alpha / 2.0, 1.0 / self.n_steps  # critically damped: a double pole at -alpha / 2
        rest = goal + pull / rate**2  # where goal and forcing term balance
        offset = self.position - rest
        slope = self.velocity + rate * offset
        left = math.exp(-rate * dt)
        self.position = rest + (offset + slope * dt) * left
        self.velocity = (self.velocity - rate * slope * dt) * left
        self.steps += 1
        return self.position.copy()


def canonical(n_steps: int) -> Array:
    """Return x at the beginning of every step, shape (n_steps,), the solution of the canonical system."""
    return np.exp(-DECAY * np.arange(n_steps) / n_steps)


def features(x: Array) -> Array:
    """Return what the weights of the forcing term are multiplied with, shape (T, 100), for x of shape (T,)."""
    psi = np.exp(-WIDTHS * (x[:, None] - CENTRES) ** 2)
    shares: Array = x[:, None] * psi / psi.sum(axis=1, keepdims=True)
    return shares
