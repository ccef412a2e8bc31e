"""Time-optimal timing of joint paths with TOPP-RA, sampled at the control rate."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline  # type: ignore[import-untyped, unused-ignore]

from dynaforge.geometry import Array, JointTrajectory
from dynaforge.planning.lazy_pyplot import lazy_pyplot
from dynaforge.sim.robot import RobotDescription

with lazy_pyplot():
    import toppra.solverwrapper
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint
    from toppra.interpolator import AbstractGeometricPath

# TOPP-RA checks at every plan which solvers can be imported, a third of its time; the answer does not change.
toppra.solverwrapper.available_solvers = functools.cache(toppra.solverwrapper.available_solvers)

LIMIT_SHARE = 0.97  # share of the velocity and acceleration limits used, which leaves the tracking loop room to correct
LINE_GRID = 20  # grid intervals of a straight edge
SPLINE_GRID = 15  # grid intervals for each segment of a spline


class Line(AbstractGeometricPath):  # type: ignore[misc]
    """The straight path between two configurations, radians, shape (n,), over s in [0, 1]."""

    def __init__(self, start: Array, end: Array) -> None:
        self._start, self._end = start, end

    @property
    def dof(self) -> int:
        return len(self._start)

    @property
    def path_interval(self) -> Array:
        return np.array((0.0, 1.0))

    @property
    def grid(self) -> Array:
        """The path positions at which TOPP-RA applies the limits, shape (N + 1,)."""
        return np.linspace(0.0, 1.0, LINE_GRID + 1)

    def __call__(self, path_positions: Any, order: int = 0) -> Array:
        s = np.asarray(path_positions, dtype=np.float64)[..., None]
        if order == 0:
            return (1.0 - s) * self._start + s * self._end  # this form hits both ends exactly
        derivative = self._end - self._start if order == 1 else np.zeros(self.dof)
        return np.broadcast_to(derivative, (*s.shape[:-1], self.dof))


class Spline(AbstractGeometricPath):  # type: ignore[misc]
    """The natural cubic spline through waypoints, radians, shape (m, n), over the length of their polyline."""

    def __init__(self, waypoints: Array) -> None:
        lengths = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
        self._knots = np.concatenate(((0.0,), np.cumsum(lengths)))
        self._spline = CubicSpline(self._knots, waypoints, bc_type="natural")

    @property
    def dof(self) -> int:
        return int(self._spline.c.shape[-1])

    @property
    def path_interval(self) -> Array:
        return self._knots[[0, -1]]

    @property
    def grid(self) -> Array:
        """The path positions at which TOPP-RA applies the limits, shape (N + 1,)."""
        shares = np.arange(SPLINE_GRID) / SPLINE_GRID
        inner = self._knots[:-1, None] + shares * np.diff(self._knots)[:, None]
        return np.append(inner.ravel(), self._knots[-1])

    def __call__(self, path_positions: Any, order: int = 0) -> Array:
        values: Array = self._spline(path_positions, order)
        return values


class PathTimer:
    """Times paths as fast as the joint velocity and acceleration limits allow.

    Args:
        robot: Gives the limits, of which 97 % are used.
        dt: Seconds between samples.
    """

    def __init__(self, robot: RobotDescription, *, dt: float) -> None:
        self._dt = dt
        self._dq_max, self._ddq_max = LIMIT_SHARE * robot.dq_max, LIMIT_SHARE * robot.ddq_max
        self._constraints = [
            JointVelocityConstraint(np.stack((-self._dq_max, self._dq_max), axis=1)),
            JointAccelerationConstraint(
                np.stack((-self._ddq_max, self._ddq_max), axis=1),
                discretization_scheme=DiscretizationType.Interpolation,
            ),
        ]

    def time(self, path: Line | Spline) -> JointTrajectory | None:
        """Time a path from rest to rest.

        TOPP-RA keeps the limits at its grid points. If a sample between them exceeds a limit, the whole motion slows
        down until none does. The duration is stretched to a whole number of samples, so that the last sample is the end
        of the path, at rest.

        Returns:
            The samples, or None if TOPP-RA finds no timing.
        """
        grid = path.grid
        solver = TOPPRA(self._constraints, path, gridpoints=grid, solver_wrapper="seidel")
        _, speeds, _ = solver.compute_parameterization(0.0, 0.0)
        if speeds is None or not np.isfinite(speeds).all():
            return None
        sums = speeds[1:] + speeds[:-1]
        if sums.min() <= 0.0:
            return None
        times = np.concatenate(((0.0,), np.cumsum(2.0 * np.diff(grid) / sums)))
        trajectory = self._sample(path, grid, speeds, times, 1.0)
        excess = self._excess(trajectory)
        return trajectory if excess <= 1.0 else self._sample(path, grid, speeds, times, excess)

    def _sample(self, path: Line | Spline, grid: Array, speeds: Array, times: Array, slower: float) -> JointTrajectory:
        """Sample the path at the control rate; between grid points the path acceleration is constant."""
        n = max(1, math.ceil(slower * times[-1] / self._dt - 1e-9))
        t = np.linspace(0.0, times[-1], n + 1)
        i = np.minimum(np.searchsorted(times, t, side="right") - 1, len(grid) - 2)
        accelerations = np.diff(speeds) / np.diff(times)
        since, sdd = t - times[i], accelerations[i][:, None]
        s = grid[i] + since * (speeds[i] + 0.5 * since * sdd[:, 0])
        sd = (speeds[i] + since * sdd[:, 0])[:, None]
        rate = times[-1] / (n * self._dt)  # seconds of the fastest timing per second
        tangent = path(s, 1)
        q = path(s)
        dq = rate * tangent * sd
        ddq = rate * rate * (path(s, 2) * sd * sd + tangent * sdd)
        q[0], q[-1] = path(grid[0]), path(grid[-1])
        dq[0] = dq[-1] = ddq[-1] = 0.0
        return JointTrajectory(self._dt, q, dq, ddq)

    def _excess(self, trajectory: JointTrajectory) -> float:
        """Return the factor by which the motion must slow down: accelerations fall with the square of the factor."""
        velocity = float((np.abs(trajectory.dq) / self._dq_max).max())
        acceleration = float((np.abs(trajectory.ddq) / self._ddq_max).max())
        return max(velocity, math.sqrt(acceleration))


def join(parts: Sequence[JointTrajectory]) -> JointTrajectory:
    """Concatenate trajectories; each starts at rest where the previous one came to rest."""
    heads = parts[:-1]  # without their last samples, which are the first of the next part
    return JointTrajectory(
        parts[-1].dt,
        np.concatenate([*(part.q[:-1] for part in heads), parts[-1].q]),
        np.concatenate([*(part.dq[:-1] for part in heads), parts[-1].dq]),
        np.concatenate([*(part.ddq[:-1] for part in heads), parts[-1].ddq]),
    )
