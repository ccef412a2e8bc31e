"""The controller of absolute actions: a target that the limits allow is reached within its control step, exactly."""

from __future__ import annotations

import numpy as np

from dynaforge.geometry import Array, JointState, Pose
from dynaforge.planning.kinematics import ArmKinematics
from dynaforge.planning.local_planner import JointReference, ramp_width, require_finite
from dynaforge.sim import HandTarget
from dynaforge.sim.robot import RobotDescription

LIMIT_TOLERANCE = 1e-3  # share of the limits left to rounding: targets are float32, inverse kinematics ends at 1e-6
TOLERANCE = 1e-6  # metres and radians
MAX_ITERATIONS = 8


class TargetFollower:
    """Moves the joint reference toward one absolute target per control step.

    What a recording calls an action is where its command stood a control step later. Given back as targets, such
    actions are met exactly, as any stream of targets is that the limits allow. The local planner of the prior cannot
    do this: it stops at each target, so it trails one that moves.

    The reference is a sequence of positions; its velocity is their difference over a control step, its acceleration
    the difference of those, and both stay inside the limits (at 30 Hz the jerk limit of 5000 rad/s^3 binds nothing).
    A motion that keeps the limits at every instant keeps them here too, since differences are means.

    Args:
        robot: Its limits.
        kinematics: Inverse kinematics.
        dt: Seconds of a control step.
    """

    def __init__(self, robot: RobotDescription, kinematics: ArmKinematics, *, dt: float) -> None:
        self.robot, self.kinematics, self.dt = robot, kinematics, dt
        self._dq_max = robot.dq_max * (1.0 + LIMIT_TOLERANCE)
        self._gain = robot.ddq_max * dt * (1.0 + LIMIT_TOLERANCE)  # most change of the velocity in one control step
        self.reset(robot.q_ready, robot.width_max)

    @property
    def reference(self) -> JointReference:
        """Where the command stands."""
        return self._reference

    def reset(self, q: Array, width: float) -> JointReference:
        """Put the reference at rest at joint positions q (rad, shape (7,)) and an opening (m).

        Raises:
            ValueError: A value is not finite.
        """
        require_finite("q", q)
        require_finite("width", float(width))
        joints = JointState.at_rest(q.copy())
        self._reference = JointReference(joints, float(width), 0.0)
        self._target, self._target_moved, self._target_velocity = joints.q, joints.dq, joints.dq
        return self._reference

    def reach(self, target: HandTarget, *, elbow: float | None = None) -> JointReference:
        """Move to a target of the hand, or as near to it as the limits allow in one control step.

        Args:
            target: Where its pose is out of reach, the nearest configuration that the solver meets is used.
            elbow: Wanted angle of the third joint, radians; a pose alone leaves one of seven joints open.

        Raises:
            ValueError: A value is not finite.
        """
        if elbow is not None:
            require_finite("elbow", float(elbow))
        return self._advance(self._solve(target.pose, elbow), target.width)

    def reach_joints(self, q_target: Array, width: float) -> JointReference:
        """Move to joint targets (rad, shape (7,), clamped to the limits) and an opening (m), as near as is allowed.

        Raises:
            ValueError: A value is not finite.
        """
        require_finite("q_target", q_target)
        return self._advance(np.clip(q_target, self.robot.q_lower, self.robot.q_upper), width)

    def _solve(self, target: Pose, elbow: float | None) -> Array:
        if elbow is None:  # from where the target was and not from the arm: its lag must not bend the solution
            return self.kinematics.solve(
                target, self._target, max_iterations=MAX_ITERATIONS, position_tolerance=TOLERANCE,
                rotation_tolerance=TOLERANCE,
            ).q  # fmt: skip
        # Two configurations can share pose and elbow, and meet where q[ELBOW] turns back: the motion goes on through.
        joints = self._reference.joints
        ahead = joints.q + joints.dq * self.dt
        return self.kinematics.solve_at_elbow(target, elbow, ahead, max_iterations=MAX_ITERATIONS, tolerance=TOLERANCE)

    def _advance(self, target: Array, width: float) -> JointReference:
        before = self._reference.joints
        width, width_speed = ramp_width(self._reference.width, width, self.robot, self.dt)
        self._follow(target)
        q, dq = self._next(before.q, before.dq)
        joints = JointState(q, dq, (dq - before.dq) / self.dt)
        self._reference = JointReference(joints, width, width_speed)
        return self._reference

    def _follow(self, target: Array) -> None:
        """Take note of the target, and of how fast it moves; where it jumps, as between two phases, it stands."""
        moved = (target - self._target) / self.dt
        steady = (np.abs(moved - self._target_moved) <= 2.0 * self._gain).all() and (
            np.abs(moved) <= self._dq_max
        ).all()
        self._target, self._target_moved = target, moved
        self._target_velocity = moved if steady else np.zeros(7)

    def _next(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return position and velocity one control step nearer to the target."""
        low, high = self._allowed(q, dq)
        there = (self._target - q) / self.dt
        lands = np.abs(there - self._target_velocity) <= self._gain  # and need not shoot past it afterwards
        if ((low <= there) & (there <= high) & lands).all():
            return self._target, there
        behind = self._target - self._target_velocity * self.dt - q
        chase = _inside(self._target_velocity, behind * self._pace(behind), low, high)
        return q + chase * self.dt, chase

    def _allowed(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return the least and the greatest next velocity of each joint: limits kept now, and room left to stop in."""
        low, high = np.maximum(-self._dq_max, dq - self._gain), np.minimum(self._dq_max, dq + self._gain)
        room_below, room_above = q - self.robot.q_lower, self.robot.q_upper - q
        return (
            np.clip(-stopping_velocity(room_below, self._gain, self.dt), low, high),
            np.clip(stopping_velocity(room_above, self._gain, self.dt), low, high),
        )

    def _pace(self, behind: Array) -> float:
        """Return the share per second at which all joints make up what they are behind, and can stop in time."""
        distance = np.maximum(np.abs(behind), 1e-12)
        return float((stopping_velocity(distance, self._gain, self.dt) / distance).min())


def stopping_velocity(distance: Array, gain: float | Array, dt: float) -> Array:
    """Return the greatest velocity from which a joint stops within a distance.

    It moves one control step at this velocity v, the next at v - gain, and so on to zero. In n steps it covers
    dt (n v - gain n (n - 1) / 2), which is the distance for the least n that does not ask for more than `gain`.

    Args:
        distance: Not negative, radians.
        gain: Change of the velocity in a control step, rad/s.
        dt: Seconds of a control step.
    """
    distance = np.maximum(distance, 0.0)
    n = np.maximum(np.ceil(0.5 * (np.sqrt(1.0 + 8.0 * distance / (gain * dt)) - 1.0)), 1.0)
    velocity: Array = distance / (n * dt) + 0.5 * gain * (n - 1.0)
    return velocity


def _inside(base: Array, chase: Array, low: Array, high: Array) -> Array:
    """Return base + s * chase inside [low, high], s <= 1 as great as can be; each joint for itself where no s serves.

    One s for all keeps the hand near the straight line.
    """
    moving = chase != 0.0
    ends = (np.stack((low, high)) - base)[:, moving] / chase[moving]
    least, most = ends.min(axis=0).max(initial=-np.inf), ends.max(axis=0).min(initial=np.inf)
    share = min(max(1.0, least), most) if least <= most else 1.0
    return np.clip(base + share * chase, low, high)
