"""The local planner: turns an end-effector target into a joint reference inside the limits, every control step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import ruckig

from dynaforge.geometry import Array, JointState, one_line
from dynaforge.planning.kinematics import ArmKinematics
from dynaforge.sim import HandTarget
from dynaforge.sim.robot import RobotDescription

ARRIVED = 1e-10  # rad, rad/s, rad/s^2
TRACKING_ITERATIONS = 2  # of inverse kinematics in a control step; the next one goes on from there
LOOK_AHEAD = 1.2  # control steps: one, and a share for what a joint moves on while its brakes build up
LEAST_SPEED = 1e-3  # rad/s; Ruckig needs a speed to plan with, even for a joint at its end that must not move on


@dataclass(frozen=True, slots=True, eq=False)
class JointReference:
    """The command to the joint controller, due at the end of a control step.

    Attributes:
        joints: State of the arm.
        width: Opening between the fingers, metres.
        width_speed: Rate of the opening over the control step, m/s.
    """

    joints: JointState
    width: float
    width_speed: float

    __repr__ = one_line

    @staticmethod
    def at_rest(q: Array, width: float) -> JointReference:
        """Return a reference that rests at joint positions q (rad, shape (7,)) and an opening (m).

        Raises:
            ValueError: A value is not finite.
        """
        require_finite("q", q)
        require_finite("width", float(width))
        return JointReference(JointState.at_rest(q.copy()), float(width), 0.0)


class LocalPlanner:
    """Moves the joint reference toward targets inside every limit: the projection of Eq. 5.

    Inverse kinematics starts at the current reference. Ruckig then moves the reference one control step toward the
    solution under the velocity, acceleration and jerk limits, with a target velocity of zero (any other would be a
    prediction). Velocity limits depend on position, and Ruckig's are constant: it gets those that still hold where they
    lead at the end of the control step. Call `reset` first.

    Args:
        robot: Gives the limits.
        kinematics: Inverse and forward kinematics.
        dt: Duration of a control step, seconds.
    """

    def __init__(self, robot: RobotDescription, kinematics: ArmKinematics, *, dt: float) -> None:
        self.robot, self.kinematics, self.dt = robot, kinematics, dt
        self._solver = ruckig.Ruckig(7, dt)
        self._output = ruckig.OutputParameter(7)
        self._input = ruckig.InputParameter(7)
        # Joints that arrive together keep the hand near the straight line; otherwise it dips into the object.
        self._input.synchronization = ruckig.Synchronization.Time
        self._speed_limits = robot.speed_limits.ahead(LOOK_AHEAD * dt)
        self._input.max_acceleration = robot.ddq_max.tolist()
        self._input.max_jerk = robot.dddq_max.tolist()
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
        return self.restore(JointReference.at_rest(q, width))

    def restore(self, reference: JointReference) -> JointReference:
        """Go on from a reference of before; all that follows depends on nothing else."""
        self._load(reference.joints)
        self._reference = reference
        return reference

    def track(self, target: HandTarget) -> JointReference:
        """Move one control step toward a target of the hand.

        If its pose is out of reach, the nearest configuration that the solver finds is used.

        Raises:
            ValueError: A value is not finite.
        """
        solution = self.kinematics.solve(target.pose, self._reference.joints.q, max_iterations=TRACKING_ITERATIONS)
        return self._advance(solution.q, target.width)

    def to_joints(self, q_target: Array, width: float) -> JointReference:
        """Move one control step toward joint targets (rad, shape (7,), clamped to the limits) and an opening (m).

        Raises:
            ValueError: A value is not finite.
        """
        require_finite("q_target", q_target)
        return self._advance(np.clip(q_target, self.robot.q_lower, self.robot.q_upper), width)

    def follow(self, sample: JointState, width: float) -> JointReference:
        """Take a sample of a planned trajectory unchanged; only the opening is ramped.

        Args:
            sample: The state due at the end of this control step.
            width: Wanted opening, metres.

        Raises:
            ValueError: A value is not finite.
        """
        require_finite("q", sample.q)
        require_finite("dq", sample.dq)
        require_finite("ddq", sample.ddq)
        width, width_speed = ramp_width(self._reference.width, width, self.robot, self.dt)
        self._load(sample)
        self._reference = JointReference(sample, width, width_speed)
        return self._reference

    def _advance(self, q_goal: Array, width: float) -> JointReference:
        width, width_speed = ramp_width(self._reference.width, width, self.robot, self.dt)
        if self._has_arrived(q_goal):
            joints = JointState.at_rest(q_goal)
            self._load(joints)
        else:
            joints = self._next(q_goal)
        self._reference = JointReference(joints, width, width_speed)
        return self._reference

    def _has_arrived(self, q_goal: Array) -> bool:
        """Return whether only rounding error is left, from which Ruckig sometimes makes NaN."""
        now = self._reference.joints
        lefts = (q_goal - now.q, now.dq, now.ddq)  # nearly always the first joint tells
        return all(abs(x) < ARRIVED for left in lefts for x in left.tolist())

    def _next(self, q_goal: Array) -> JointState:
        """Return the state one control step nearer to the goal."""
        down, up = np.maximum(self._speed_limits.toward_ends(self._reference.joints.q), LEAST_SPEED).tolist()
        self._input.min_velocity = [-speed for speed in down]
        self._input.max_velocity = up
        self._input.target_position = q_goal.tolist()
        output = self._output
        try:
            self._solver.update(self._input, output)
        except ruckig.RuckigError:
            # Synchronisation sometimes fails when the joints have almost arrived; without it Ruckig always succeeds.
            self._input.synchronization = ruckig.Synchronization.No
            self._solver.update(self._input, output)
            self._input.synchronization = ruckig.Synchronization.Time
        output.pass_to_input(self._input)
        return JointState(*np.array((output.new_position, output.new_velocity, output.new_acceleration)))

    def _load(self, joints: JointState) -> None:
        """Give Ruckig a state and discard its running trajectory, so that nothing depends on what came before."""
        self._solver.reset()
        self._input.current_position = joints.q.tolist()
        self._input.current_velocity = joints.dq.tolist()
        self._input.current_acceleration = joints.ddq.tolist()


def ramp_width(before: float, wanted: float, robot: RobotDescription, dt: float) -> tuple[float, float]:
    """Return the opening one control step nearer to the wanted one (m), and its rate over the step (m/s).

    Args:
        before: Opening before the step, metres.
        wanted: Wanted opening, metres.
        robot: Gives the fingers' largest speed and the largest opening.
        dt: Duration of a control step, seconds.

    Raises:
        ValueError: The wanted opening is not finite.
    """
    require_finite("width", float(wanted))
    step = 2.0 * robot.finger_speed_max * dt
    wanted = min(max(float(wanted), 0.0), robot.width_max)
    after = min(max(wanted, before - step), before + step)
    return after, (after - before) / dt


def require_finite(name: str, value: Array | float) -> None:
    """Raise ValueError unless all numbers are finite."""
    # The sum of a few numbers is finite if they all are; with plain floats it takes a third of the time of numpy's.
    if not math.isfinite(value if isinstance(value, float) else sum(value.tolist())):
        raise ValueError(f"{name} is {np.asarray(value).tolist()}; it must be finite.")
