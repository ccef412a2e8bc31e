"""Time-optimal timing of joint paths at the control rate: straight edges in closed form, splines by TOPP-RA."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline  # type: ignore[import-untyped, unused-ignore]

from dynaforge.geometry import Array, JointTrajectory
from dynaforge.planning.lazy_pyplot import lazy_pyplot
from dynaforge.sim.arm_dynamics import ArmDynamics
from dynaforge.sim.robot import RobotDescription

with lazy_pyplot():
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraintVarying
    from toppra.interpolator import AbstractGeometricPath

LIMIT_SHARE = 0.97  # share of the velocity and acceleration limits used, which leaves the tracking loop room to correct
TORQUE_SHARE = 0.85  # of the torque limits; the rest is for the controller and for what the hand holds (1 kg or so)
TORQUE_FLOOR = 0.05  # of the torque limits, left to move with where the arm's weight alone takes more than that
LINE_GRID = 40  # grid intervals of a straight edge
ROTATION_SHARE = 0.9  # of what the weight leaves of a torque limit, granted to what grows with the speed
TORQUE_PASSES = 5
SLOWDOWNS = 10  # a slower motion is sampled elsewhere, and is checked again
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
    """Times paths as fast as the limits of joint velocity, acceleration and torque allow.

    Velocity limits depend on position. Of the torque limits 85 % are used, for the arm with an empty hand; where its
    weight alone takes more than 80 %, 5 % beyond the weight.

    Args:
        robot: Gives the limits; of those of velocity and acceleration, 97 % are used.
        dt: Seconds between samples.
    """

    def __init__(self, robot: RobotDescription, *, dt: float) -> None:
        self._dt, self._robot = dt, robot
        self._dynamics = ArmDynamics(robot)
        self._ddq_max = LIMIT_SHARE * robot.ddq_max
        self._acceleration_constraint = JointAccelerationConstraint(
            np.stack((-self._ddq_max, self._ddq_max), axis=1),
            discretization_scheme=DiscretizationType.Interpolation,
        )

    def time(self, path: Line | Spline) -> JointTrajectory | None:
        """Time a path from rest to rest.

        The limits are kept at the points of a grid. If a sample between them exceeds a limit, the whole motion slows
        down until none does. The duration is stretched to a whole number of samples, so that the last sample is the end
        of the path, at rest.

        Returns:
            The samples, or None if there is no timing.
        """
        grid = path.grid
        speeds = self._line_speeds(path, grid) if isinstance(path, Line) else self._spline_speeds(path, grid)
        if speeds is None or not np.isfinite(speeds).all():
            return None
        sums = speeds[1:] + speeds[:-1]
        if sums.min() <= 0.0:
            return None
        times = np.concatenate(((0.0,), np.cumsum(2.0 * np.diff(grid) / sums)))
        slower = 1.0
        for _ in range(SLOWDOWNS):
            trajectory = self._sample(path, grid, speeds, times, slower)
            excess = self._excess(trajectory)
            if excess <= 1.0 + 1e-9:
                return trajectory
            slower = excess * trajectory.duration / float(times[-1])
        return None

    def _line_speeds(self, line: Line, grid: Array) -> Array:
        """Return the greatest path speeds on a grid of a straight edge, shape (N + 1,), in closed form.

        Along the edge every limit bounds the squared path speed x or its slope, twice the path acceleration. The
        fastest x is the largest below its bound that nowhere rises or falls faster than allowed: one pass forward, one
        backward. A torque is m a + h x + g in the path acceleration a: its bounds of a depend on x, and are those at
        the x of the pass before.
        """
        q, tangent = line(grid), line(0.5, 1)
        moving = np.abs(tangent) > 1e-12
        lower, upper = self._robot.speed_limits(q)
        reach = np.where(tangent > 0.0, upper, -lower)[:, moving] / np.abs(tangent[moving])
        bound = (LIMIT_SHARE * reach.min(axis=1)) ** 2
        weight, inertia, rotation = self._dynamics.along_line(q, tangent)
        limit, size, sign = self._torque_limit(weight), np.maximum(np.abs(inertia), 1e-12), np.sign(inertia)
        room = ROTATION_SHARE * (limit - np.abs(weight)) / np.maximum(np.abs(rotation), 1e-12)
        bound = np.minimum(bound, room.min(axis=1))
        bound[0] = bound[-1] = 0.0
        most = np.full(len(grid), float((self._ddq_max[moving] / np.abs(tangent[moving])).min()))
        squared = _fastest(bound, most, most, grid)
        for _ in range(TORQUE_PASSES):
            torque = sign * (weight + rotation * squared[:, None])
            up = np.minimum(((limit - torque) / size).min(axis=1), most)
            down = np.minimum(((limit + torque) / size).min(axis=1), most)
            squared = _fastest(bound, up, down, grid)
        speeds: Array = np.sqrt(squared)
        return speeds

    def _spline_speeds(self, spline: Spline, grid: Array) -> Array | None:
        """Return the greatest path speeds that TOPP-RA finds; torques are left to the check of the samples."""

        def velocity_limits(s: float) -> Array:
            return LIMIT_SHARE * np.stack(self._robot.speed_limits(spline(s)), axis=1)

        constraints = [JointVelocityConstraintVarying(velocity_limits), self._acceleration_constraint]
        solver = TOPPRA(constraints, spline, gridpoints=grid, solver_wrapper="seidel")
        speeds: Array | None = solver.compute_parameterization(0.0, 0.0)[1]
        return speeds

    def _torque_limit(self, weight: Array) -> Array:
        most = self._robot.effort_max
        limit: Array = np.maximum(TORQUE_SHARE * most, np.abs(weight) + TORQUE_FLOOR * most)
        return limit

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
        """Return the factor by which the motion must slow down.

        Accelerations, and torques beyond the weight, fall with the square of the factor.
        """
        lower, upper = (LIMIT_SHARE * limit for limit in self._robot.speed_limits(trajectory.q))
        with np.errstate(divide="ignore", invalid="ignore"):  # a joint that may not move and does not is inside
            velocity = float(np.nanmax(np.where(trajectory.dq > 0.0, trajectory.dq / upper, trajectory.dq / lower)))
        acceleration = float((np.abs(trajectory.ddq) / self._ddq_max).max())
        weight, torque = self._dynamics.torques(trajectory)
        added = torque - weight
        room = self._torque_limit(weight) - np.sign(added) * weight
        return max(velocity, math.sqrt(max(acceleration, float((np.abs(added) / room).max()))))


def _fastest(bound: Array, up: Array, down: Array, grid: Array) -> Array:
    """Return the largest squared speeds below a bound that rise and fall no faster than allowed, shape (N + 1,).

    Args:
        bound: Of the squared speed, shape (N + 1,), as are the others.
        up: Greatest acceleration.
        down: Greatest deceleration.
        grid: Path positions.
    """
    steps = 2.0 * np.diff(grid)
    rise, fall = (np.concatenate(((0.0,), np.cumsum(steps * np.minimum(most[1:], most[:-1])))) for most in (up, down))
    squared = np.minimum.accumulate(bound - rise) + rise
    squared = np.minimum.accumulate((squared + fall)[::-1])[::-1] - fall
    squared[0] = squared[-1] = 0.0
    result: Array = np.maximum(squared, 0.0)
    return result


def join(parts: Sequence[JointTrajectory]) -> JointTrajectory:
    """Concatenate trajectories; each starts at rest where the previous one came to rest."""
    heads = parts[:-1]  # without their last samples, which are the first of the next part
    return JointTrajectory(
        parts[-1].dt,
        np.concatenate([*(part.q[:-1] for part in heads), parts[-1].q]),
        np.concatenate([*(part.dq[:-1] for part in heads), parts[-1].dq]),
        np.concatenate([*(part.ddq[:-1] for part in heads), parts[-1].ddq]),
    )
