"""Joint trajectories sampled at the control rate."""

from __future__ import annotations

from dataclasses import dataclass

from dynaforge.geometry.one_line import one_line
from dynaforge.geometry.pose import Array


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectory:
    """A joint motion on a regular time grid; sample k is due k * dt seconds after the start.

    Attributes:
        dt: Seconds between samples.
        q: Joint positions, radians, shape (T, 7).
        dq: Joint velocities, rad/s, shape (T, 7).
        ddq: Joint accelerations, rad/s^2, shape (T, 7).
    """

    dt: float
    q: Array
    dq: Array
    ddq: Array

    __repr__ = one_line

    def __len__(self) -> int:
        return len(self.q)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return (len(self.q) - 1) * self.dt
