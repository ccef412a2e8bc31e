"""Joint speed limits that depend on position: the nearer a joint is to an end of its range, the slower it may move."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynaforge.geometry import Array, one_line
from dynaforge.sim.checks import check_number, finite_array, quoted

LEAST_LIMIT = 1e-9  # rad/s; shares of a limit of 0 are taken of this instead


@dataclass(frozen=True, eq=False, kw_only=True)
class SpeedLimits:
    """How fast each joint may move from where it is; called with joint positions, it returns the limits there.

    Toward an end of its range at the distance d, a joint may move at sqrt(gain d) - offset, at least at 0 and at most
    at `cap`. This is the rule by which libfranka and the Franka Research 3 limit commands. The root is a braking
    parabola: along it, the joint brakes at up to gain / 2.

    Attributes:
        cap: Limits far from both ends, rad/s, shape (7,).
        offset: What is subtracted from the root, rad/s, shape (7,).
        gain: Factor of the distance, rad/s^2, shape (7,).
        lower, upper: Ends of the range, radians, shape (7,). The speed is 0 already offset^2 / gain before them.
    """

    cap: Array
    offset: Array
    gain: Array
    lower: Array
    upper: Array

    __repr__ = one_line

    def __post_init__(self) -> None:
        for name in ("cap", "offset", "gain", "lower", "upper"):
            values = finite_array(f"SpeedLimits: {name}", getattr(self, name), (7,))
            object.__setattr__(self, name, values)
            if name in ("cap", "offset", "gain") and (values <= 0.0).any():
                raise ValueError(f"SpeedLimits: {name} is {quoted(values.tolist())}; all seven must be above 0.")
        if not (self.lower < self.upper).all():
            raise ValueError("SpeedLimits: lower is not below upper in every joint.")

    def __call__(self, q: Array) -> tuple[Array, Array]:
        """Return the least and the greatest velocity allowed at joint positions, rad/s, shape (..., 7) each.

        Args:
            q: Joint positions, radians, shape (..., 7).
        """
        speeds = self.toward_ends(q)
        return -speeds[..., 0, :], speeds[..., 1, :]

    def toward_ends(self, q: Array) -> Array:
        """Return the greatest speeds allowed toward the lower and toward the upper end, rad/s, shape (..., 2, 7).

        Args:
            q: Joint positions, radians, shape (..., 7).
        """
        slope, intercept = self._gain_times_distance
        roots = np.sqrt(np.maximum(slope * q[..., None, :] + intercept, 0.0))
        speeds: Array = np.minimum(np.maximum(roots - self.offset, 0.0), self.cap)
        return speeds

    def share(self, q: Array, dq: Array) -> Array:
        """Return the largest share of its limit that a joint uses; above 1, a limit is exceeded, shape (...,).

        Args:
            q: Joint positions, radians, shape (..., 7).
            dq: Joint velocities there, rad/s, shape (..., 7).
        """
        lower, upper = self(q)
        limits = np.where(dq > 0.0, upper, -lower)
        shares: Array = (np.abs(dq) / np.maximum(limits, LEAST_LIMIT)).max(axis=-1)
        return shares

    @cached_property
    def _gain_times_distance(self) -> tuple[Array, Array]:
        """Slope and intercept, shape (2, 7) each, of gain times the distances to the lower and to the upper end."""
        return np.stack((self.gain, -self.gain)), np.stack((-self.gain * self.lower, self.gain * self.upper))

    def ahead(self, seconds: float) -> SpeedLimits:
        """Return the limits that hold a time ahead.

        They allow a joint the greatest speed that is still allowed where it leads in that time. Solving
        v = sqrt(gain (d - v t)) - offset for v gives a curve of the same form.

        Args:
            seconds: The time, t in the equation.
        """
        check_number("seconds", seconds, least=0.0)
        wider = self.offset * seconds + 0.25 * self.gain * seconds**2
        return SpeedLimits(
            cap=self.cap,
            offset=self.offset + 0.5 * self.gain * seconds,
            gain=self.gain,
            lower=self.lower - wider,
            upper=self.upper + wider,
        )
