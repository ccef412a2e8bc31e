"""The global planner: one collision-free, time-optimal joint trajectory at the entry of a stable phase."""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise
from typing import Literal

import numpy as np
import ruckig

from dynaforge.geometry import Array, JointState, JointTrajectory, Pose
from dynaforge.planning.collision import CollisionModel
from dynaforge.planning.kinematics import ArmKinematics
from dynaforge.planning.rrt import rrt_connect, shortcut
from dynaforge.planning.timing import Line, PathTimer, Spline, join
from dynaforge.sim.robot import RobotDescription

Reason = Literal["unreachable", "goal in collision", "start in collision", "no path", "timing failed"]

RESOLUTION = 0.015  # radians of the fastest joint between collision checks
AT_REST = 1e-4  # rad/s and rad/s^2 below which the arm counts as being at rest
ESCAPE_LIMIT = 0.15  # radians within which a motion must leave a collision that it starts in
RETREATS = (0.02, 0.05, 0.1)  # metres upward, tried in turn, to leave such a collision
SPLINE_DETAIL = (1, 2, 4)  # pieces into which edges are cut, tried in turn until the spline is free


class PlanFailure(Exception):  # noqa: N818  (a result that callers handle, named as the docs name it)
    """There is no trajectory, or none was found.

    Attributes:
        reason: "unreachable", "goal in collision", "start in collision", "no path" or "timing failed".
    """

    def __init__(self, reason: Reason, message: str) -> None:
        super().__init__(reason, message)
        self.reason: Reason = reason

    def __str__(self) -> str:
        return f"{self.args[0]}: {self.args[1]}"


class GlobalPlanner:
    """Plans from any joint state to rest at an end-effector pose: brake, goal IK, path, timing.

    It is deterministic: the same inputs and generator state give the same trajectory bit for bit.

    Args:
        robot: Gives the limits.
        kinematics: Finds the goal configuration.
        collision: The bodies that must not be touched.
        dt: Seconds between the samples of a trajectory.
    """

    def __init__(
        self, robot: RobotDescription, kinematics: ArmKinematics, collision: CollisionModel, *, dt: float
    ) -> None:
        self.robot, self.kinematics, self.collision, self.dt = robot, kinematics, collision, dt
        self._timer = PathTimer(robot, dt=dt)
        self._brake_solver = ruckig.Ruckig(7)
        self._brake_input = ruckig.InputParameter(7)
        self._brake_input.control_interface = ruckig.ControlInterface.Velocity
        self._brake_input.synchronization = ruckig.Synchronization.No  # no joint waits for a slower one
        self._brake_input.max_acceleration = robot.ddq_max.tolist()
        self._brake_input.max_jerk = robot.dddq_max.tolist()

    def plan(self, start: JointState, target: Pose, *, rng: np.random.Generator) -> JointTrajectory:
        """Plan a trajectory that starts at a joint state and ends at rest at an end-effector pose.

        A moving arm first brakes. The goal configuration is the inverse kinematics solution found from where the arm
        then is, or failing that the nearest one in closed form. The path is the straight joint-space edge, or failing
        that a path found by RRT-Connect. If the arm starts in a shallow collision (a hand that grazes the table), it
        first leaves it.

        Args:
            start: Joint state to start from, moving or at rest.
            target: Wanted `T_world_ee`.
            rng: Draws the samples of RRT-Connect.

        Returns:
            Samples on the dt grid; the first is the given state, the last is the goal, at rest.

        Raises:
            PlanFailure: There is none; the reason says why.
            ValueError: A value is not finite.
        """
        _require_finite(start, target)
        parts, q = [], start.q
        if max(np.abs(start.dq).max(), np.abs(start.ddq).max()) > AT_REST:
            parts.append(self._brake(start))
            q = parts[0].q[-1]
        goal = self._goal(target, q)
        if self.collision.in_collision(q) and not self._leaves_collision(q, goal):
            retreat = self._retreat(q)
            parts.append(self._timed(Line(q, retreat)))
            q = retreat
        parts += self._move(q, goal, rng)
        return join(parts)

    def _brake(self, start: JointState) -> JointTrajectory:
        """Come to rest as fast as acceleration and jerk limits allow."""
        given, trajectory = self._brake_input, ruckig.Trajectory(7)
        dq, ddq = start.dq.tolist(), start.ddq.tolist()
        given.current_position, given.current_velocity, given.current_acceleration = start.q.tolist(), dq, ddq
        given.target_velocity = given.target_acceleration = [0.0] * 7
        try:
            self._brake_solver.calculate(given, trajectory)
        except ruckig.RuckigError as error:
            raise PlanFailure("timing failed", f"there is no braking motion from dq {dq}, ddq {ddq}.") from error
        n = max(1, math.ceil(trajectory.duration / self.dt - 1e-9))
        samples = np.array([trajectory.at_time(k * self.dt) for k in range(n + 1)])  # (n + 1, 3, 7)
        samples[-1, 1:] = 0.0
        return JointTrajectory(self.dt, samples[:, 0], samples[:, 1], samples[:, 2])

    def _goal(self, target: Pose, q: Array) -> Array:
        result = self.kinematics.solve_cold(target, q_seed=q, valid=lambda goal: not self.collision.in_collision(goal))
        where = f"the end effector at {np.round(target.position, 3).tolist()} m"
        if not result.converged:
            raise PlanFailure("unreachable", f"no configuration has {where}.")
        pair = self.collision.colliding_pair(result.q)
        if pair:
            raise PlanFailure("goal in collision", f"with {where}, {pair[0]} touches {pair[1]}.")
        return result.q

    def _leaves_collision(self, q0: Array, q1: Array) -> bool:
        """Return whether a straight edge that starts in collision soon leaves it and stays free."""
        n = max(1, math.ceil(float(np.abs(q1 - q0).max()) / RESOLUTION))
        path = q0 + np.linspace(0.0, 1.0, n + 1)[:, None] * (q1 - q0)
        within = math.ceil(ESCAPE_LIMIT / RESOLUTION)
        first_free = next((k for k, q in enumerate(path[: within + 1]) if not self.collision.in_collision(q)), None)
        return first_free is not None and self.collision.edge_free(path[first_free], q1, resolution=RESOLUTION)

    def _retreat(self, q: Array) -> Array:
        """Find a free configuration straight above one in shallow collision."""
        here = self.kinematics.forward(q)
        for height in RETREATS:
            above = Pose(here.rotation, here.position + np.array((0.0, 0.0, height)))
            result = self.kinematics.solve(above, q, max_iterations=20)
            if result.converged and self._leaves_collision(q, result.q):
                return result.q
        pair = self.collision.colliding_pair(q)
        raise PlanFailure("start in collision", f"{' touches '.join(pair or ())}, and moving up does not free it.")

    def _move(self, q: Array, goal: Array, rng: np.random.Generator) -> list[JointTrajectory]:
        """Return timed motions, each from rest to rest, that lead from q to the goal."""
        if float(np.abs(goal - q).max()) < 1e-9:
            still = np.zeros((1, 7))
            return [JointTrajectory(self.dt, goal[None].copy(), still, still.copy())]
        # Collisions are checked at points, and a spline is followed in chords: the clearance covers both, unless an end
        # is too near to an obstacle to keep it.
        clear = not any(self.collision.in_collision(end, clear=True) for end in (q, goal))
        edge_free = partial(self.collision.edge_free, resolution=RESOLUTION, clear=clear)
        if self.collision.in_collision(q) or edge_free(q, goal):
            return [self._timed(Line(q, goal))]
        path = rrt_connect(q, goal, edge_free=edge_free, lower=self.robot.q_lower, upper=self.robot.q_upper, rng=rng)
        if path is None:
            raise PlanFailure("no path", f"RRT-Connect found no path to {np.round(goal, 3).tolist()} rad.")
        path = shortcut(path, edge_free=edge_free, rng=rng)
        return self._rounded(path, clear) or [self._timed(Line(a, b)) for a, b in pairwise(path)]

    def _rounded(self, path: list[Array], clear: bool) -> list[JointTrajectory]:
        """Follow a polyline without stopping, on a spline near enough to it to be free; empty if there is none."""
        for detail in SPLINE_DETAIL if len(path) > 2 else ():
            shares = np.arange(detail)[:, None] / detail
            pieces = [a + shares * (b - a) for a, b in pairwise(path)]
            spline = Spline(np.concatenate([*pieces, path[-1][None]]))
            if self._free_inside_limits(spline, clear):
                trajectory = self._timer.time(spline)
                return [] if trajectory is None else [trajectory]
        return []

    def _free_inside_limits(self, spline: Spline, clear: bool) -> bool:
        start, end = spline.path_interval.tolist()
        points = spline(np.linspace(start, end, math.ceil((end - start) / RESOLUTION) + 1))
        inside = (points >= self.robot.q_lower).all() and (points <= self.robot.q_upper).all()
        return bool(inside) and not any(self.collision.in_collision(q, clear=clear) for q in points)

    def _timed(self, path: Line) -> JointTrajectory:
        trajectory = self._timer.time(path)
        if trajectory is None:
            raise PlanFailure("timing failed", "no timing of a straight edge keeps the limits.")
        return trajectory


def _require_finite(start: JointState, target: Pose) -> None:
    given = {
        "q": start.q,
        "dq": start.dq,
        "ddq": start.ddq,
        "target position": target.position,
        "target rotation": target.rotation,
    }
    for name, value in given.items():
        if not np.isfinite(value).all():
            raise ValueError(f"Cannot plan: {name} is {value.tolist()}; it must be finite.")
