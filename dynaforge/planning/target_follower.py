"""The controller of absolute actions: a target that the limits allow is reached exactly within its control step."""

from __future__ import annotations

import numpy as np

from dynaforge.geometry import Array, JointState, Pose
from dynaforge.planning.kinematics import ArmKinematics
from dynaforge.planning.local_planner import JointReference, ramp_width, require_finite
from dynaforge.sim import HandTarget
from dynaforge.sim.robot import RobotDescription

LIMIT_TOLERANCE = 1e-3  # share of the limits added for rounding: targets are float32, and IK stops at an error of 1e-6
TOLERANCE = 1e-6  # metres and radians
MAX_ITERATIONS = 8


class TargetFollower:
    """Moves the joint reference toward one absolute target per control step.

    A recorded action is where the command was one control step later. Such actions, given as targets, are reached
    exactly, as is any sequence of targets that the limits allow. The planner's `LocalPlanner` cannot do this: it stops
    at each target, so it trails a moving one.

    The reference is a sequence of positions. Its velocity is their difference over a control step, its acceleration the
    difference of the velocities, and both stay inside the limits (at 30 Hz the jerk limit of 5000 rad/s^3 never
    applies). A motion that keeps the limits at every instant keeps them here too, because differences are means. The
    velocity limits are those of the middle of the step.

    Args:
        robot: Gives the limits.
        kinematics: Inverse kinematics.
        dt: Duration of a control step, seconds.
    """

    def __init__(self, robot: RobotDescription, kinematics: ArmKinematics, *, dt: float) -> None:
        self.robot, self.kinematics, self.dt = robot, kinematics, dt
        self._dq_max = robot.dq_max * (1.0 + LIMIT_TOLERANCE)
        self._speed_limits = robot.speed_limits.ahead(0.5 * dt)
        self._max_change = robot.ddq_max * dt * (1.0 + LIMIT_TOLERANCE)  # of the velocity in one control step, rad/s
        self.reset(robot.q_ready, robot.width_max)

    @property
    def reference(self) -> JointReference:
        """The current joint reference."""
        return self._reference

    def reset(self, q: Array, width: float) -> JointReference:
        """Set the reference to rest at joint positions q (rad, shape (7,)) and an opening (m).

        Raises:
            ValueError: A value is not finite.
        """
        self._reference = JointReference.at_rest(q, width)
        joints = self._reference.joints
        self._target, self._target_moved, self._target_velocity = joints.q, joints.dq, joints.dq
        return self._reference

    def reach(self, target: HandTarget, *, elbow: float | None = None) -> JointReference:
        """Move to a target of the hand, or as near to it as the limits allow in one control step.

        Args:
            target: If its pose is out of reach, the nearest configuration that the solver finds is used.
            elbow: Wanted angle of the third joint, radians; a pose leaves one degree of freedom undetermined.

        Raises:
            ValueError: A value is not finite.
        """
        if elbow is not None:
            require_finite("elbow", float(elbow))
        return self._advance(self._solve(target.pose, elbow), target.width)

    def reach_joints(self, q_target: Array, width: float) -> JointReference:
        """Move to joint targets (rad, shape (7,), clamped to the limits) and an opening (m), as near as allowed.

        Raises:
            ValueError: A value is not finite.
        """
        require_finite("q_target", q_target)
        return self._advance(np.clip(q_target, self.robot.q_lower, self.robot.q_upper), width)

    def _solve(self, target: Pose, elbow: float | None) -> Array:
        if elbow is None:  # starts at the last target, not at the reference, whose lag must not affect the solution
            result = self.kinematics.solve(
                target,
                self._target,
                max_iterations=MAX_ITERATIONS,
                position_tolerance=TOLERANCE,
                rotation_tolerance=TOLERANCE,
            )
            return result.q
        # Two configurations can have the same pose and elbow, and they meet where q[ELBOW] turns back. A start ahead of
        # the reference takes the solution through that point along with the motion.
        joints = self._reference.joints
        ahead = joints.q + joints.dq * self.dt
        return self.kinematics.solve_at_elbow(target, elbow, ahead, max_iterations=MAX_ITERATIONS, tolerance=TOLERANCE)

    def _advance(self, target: Array, width: float) -> JointReference:
        before = self._reference.joints
        width, width_speed = ramp_width(self._reference.width, width, self.robot, self.dt)
        self._note_target(target)
        q, dq = self._next(before.q, before.dq)
        joints = JointState(q, dq, (dq - before.dq) / self.dt)
        self._reference = JointReference(joints, width, width_speed)
        return self._reference

    def _note_target(self, target: Array) -> None:
        """Remember the target and its velocity, which is zero when the target jumps, as between two phases."""
        moved = (target - self._target) / self.dt
        within_speed = (np.abs(moved) <= self._dq_max).all()
        within_change = (np.abs(moved - self._target_moved) <= 2.0 * self._max_change).all()
        self._target, self._target_moved = target, moved
        self._target_velocity = moved if within_speed and within_change else np.zeros(7)

    def _next(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return position and velocity one control step nearer to the target."""
        low, high = self._allowed_velocities(q, dq)
        direct = (self._target - q) / self.dt  # the velocity that reaches the target in this step
        can_follow = np.abs(direct - self._target_velocity) <= self._max_change  # does not overshoot it afterwards
        if ((low <= direct) & (direct <= high) & can_follow).all():
            return self._target, direct
        lag = self._target - self._target_velocity * self.dt - q
        velocity = _clamped_sum(self._target_velocity, lag * self._catch_up_rate(lag), low, high)
        return q + velocity * self.dt, velocity

    def _allowed_velocities(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return the least and the greatest next velocity of each joint that keep the limits and leave room to stop."""
        lower, upper = self._speed_limits(q)
        rounding = LIMIT_TOLERANCE * self.robot.dq_max
        low = np.maximum(lower - rounding, dq - self._max_change)
        high = np.minimum(upper + rounding, dq + self._max_change)
        room_below, room_above = q - self.robot.q_lower, self.robot.q_upper - q
        return (
            np.clip(-stopping_velocity(room_below, self._max_change, self.dt), low, high),
            np.clip(stopping_velocity(room_above, self._max_change, self.dt), low, high),
        )

    def _catch_up_rate(self, lag: Array) -> float:
        """Return the share of their lag, per second, that all joints can make up and still stop in time."""
        distance = np.maximum(np.abs(lag), 1e-12)
        return float((stopping_velocity(distance, self._max_change, self.dt) / distance).min())


def stopping_velocity(distance: Array, max_change: float | Array, dt: float) -> Array:
    """Return the greatest velocity from which a joint stops within a distance.

    It moves one control step at this velocity v, the next at v - c, where c is `max_change`, and so on down to zero. In
    n steps it covers dt (n v - c n (n - 1) / 2). This equals the distance for the least n that needs no change above c.

    Args:
        distance: Distance, radians; negative ones count as zero.
        max_change: Largest change of the velocity in a control step, rad/s.
        dt: Duration of a control step, seconds.
    """
    distance = np.maximum(distance, 0.0)
    n = np.maximum(np.ceil(0.5 * (np.sqrt(1.0 + 8.0 * distance / (max_change * dt)) - 1.0)), 1.0)
    velocity: Array = distance / (n * dt) + 0.5 * max_change * (n - 1.0)
    return velocity


def _clamped_sum(base: Array, extra: Array, low: Array, high: Array) -> Array:
    """Return base + s * extra inside [low, high], with s as near to 1 as possible.

    One s for all joints keeps the hand near the straight line. If no s is inside the bounds, each joint is clamped.
    """
    moving = extra != 0.0
    ends = (np.stack((low, high)) - base)[:, moving] / extra[moving]
    least, most = ends.min(axis=0).max(initial=-np.inf), ends.max(axis=0).min(initial=np.inf)
    s = min(max(1.0, least), most) if least <= most else 1.0
    return np.clip(base + s * extra, low, high)
