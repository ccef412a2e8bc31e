"""Joint states, and joint trajectories sampled at the control rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaforge.geometry.one_line import one_line
from dynaforge.geometry.pose import Array


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """Positions, velocities and accelerations of the arm's joints.

    Attributes:
        q: Positions, radians, shape (7,).
        dq: Velocities, rad/s, shape (7,).
        ddq: Accelerations, rad/s^2, shape (7,).
    """

    q: Array
    dq: Array
    ddq: Array

    __repr__ = one_line

    @staticmethod
    def at_rest(q: Array) -> JointState:
        """Return the state of an arm at rest at joint positions q, radians, shape (7,)."""
        return JointState(q, np.zeros_like(q), np.zeros_like(q))


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

    def __getitem__(self, k: int) -> JointState:
        """Return sample k; negative indices count from the end."""
        return JointState(self.q[k], self.dq[k], self.ddq[k])

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return (len(self.q) - 1) * self.dt
