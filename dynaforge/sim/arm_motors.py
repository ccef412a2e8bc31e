"""The arm's motors: they track a joint reference and yield where something is in the way."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from dynaforge.geometry import Array
from dynaforge.sim.arm_dynamics import ArmDynamics
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.robot import RobotDescription

POSITION_GAIN = 0.3
VELOCITY_GAIN = 1.0


class ArmCommand(NamedTuple):
    """What the arm's motors are told for one substep.

    Attributes:
        q: Joint positions at its start, radians.
        dq: Joint velocities at its end, rad/s.
        torque: Torques fed forward during it, Nm.
    """

    q: list[float]
    dq: list[float]
    torque: list[float]


class ArmMotors:
    """Moves the arm along a joint reference with no more force than that needs.

    Between the references of two control steps the arm follows a cubic whose velocity is continuous. Its velocity at a
    reference is extrapolated from the last two mean velocities, so that it depends on positions alone and is exact
    where the acceleration is constant. (On straight lines, whose velocity jumps at every reference, the second joint
    was at its torque limit in 7 % of all substeps in free motion.)

    The torque that this motion needs is fed forward (`ArmDynamics`). A motor of Bullet's corrects what is left, and
    gives `RobotDescription.torque_margin` at most. An arm that is held back thus pushes with no more than the margin
    divided by its lever: 2.5 cm past a rigid contact, with 80 N at most, where motors limited by the robot's torque
    alone give 340 to 550 N. In free motion the margin is not used up, and tracking is as good as with such motors. A
    joint impedance with the gains of libfranka's examples is unstable at 240 Hz; with a tenth of the damping it tracks
    many times worse and presses with up to 280 N.

    Args:
        client: The physics client.
        body: Bullet's index of the robot.
        joints: Bullet's indices of the arm's joints.
        robot: Limits and margins.
        substeps: Number of substeps in a control step.
        control_dt: Duration of a control step, seconds.

    Attributes:
        dynamics: The arm's equation of motion.
        last: The commands of the latest control step.
    """

    def __init__(
        self, client: Any, body: int, joints: list[int], robot: RobotDescription, *, substeps: int, control_dt: float
    ) -> None:
        self.dynamics = ArmDynamics(robot)
        self._robot, self._substeps = robot, substeps
        self._most = robot.effort_max - robot.torque_margin
        self._least = -self._most
        # Positional arguments: Bullet takes a third less time to read them than names.
        self._feed_forward = partial(client.setJointMotorControlArray, body, joints, p.TORQUE_CONTROL)
        self._correct = partial(client.setJointMotorControlArray, body, joints, p.POSITION_CONTROL)
        self._margin, self._velocity_gains = robot.torque_margin.tolist(), [VELOCITY_GAIN] * len(joints)
        self._motion = _cubic(substeps, control_dt)
        middle = (np.arange(substeps) + 0.5) / substeps
        self._blend = np.column_stack((1.0 - middle, middle))
        self.reset()

    def reset(self, gain: float = 1.0, *, q: Array | None = None) -> None:
        """Start at rest.

        Args:
            gain: Factor on the position gain, which differs from arm to arm.
            q: Where the arm is, radians, shape (7,); None: at its ready pose.
        """
        self._gains = [gain * POSITION_GAIN] * 7
        self._q = self._robot.q_ready if q is None else q
        self._dq, self._moved = np.zeros(7), np.zeros(7)
        self.last: list[ArmCommand] = []

    def plan(self, q: Array) -> list[ArmCommand]:
        """Return the commands of the control step that ends at joint positions q (rad, shape (7,)), and move on."""
        n, q0, dq0, move = self._substeps, self._q, self._dq, q - self._q
        motion = self._motion @ np.array((q0, move, dq0, self._moved))
        dq, first, last = motion[2 * n :]
        torques = np.array((self.dynamics.torque(q0, dq0, first), self.dynamics.torque(q, dq, last)))
        torques = np.minimum(np.maximum(self._blend @ torques, self._least), self._most)
        self._q, self._dq, self._moved = q, dq, move
        path, velocities = motion[:n].tolist(), motion[n : 2 * n].tolist()
        self.last = list(map(ArmCommand, path, velocities, torques.tolist()))
        return self.last

    def run(self, command: ArmCommand) -> None:
        """Command the motors for the next substep."""
        self._correct(command.q, command.dq, self._margin, self._gains, self._velocity_gains)
        self._feed_forward(forces=command.torque)


def _cubic(substeps: int, dt: float) -> Array:
    """Return the matrix that makes a control step's motion out of its ends, shape (2 substeps + 3, 4).

    It is applied to four rows: position at the start, move during the control step, velocity at the start, move during
    the control step before. It gives, one below the other, the positions at the start of each substep and the
    velocities at its end, since Bullet compares a position with the one before the substep and a velocity with the one
    after it; then the velocity at the end, and the accelerations at the start and at the end.

    Args:
        substeps: Number of substeps in a control step.
        dt: Duration of a control step, seconds.
    """
    place, move, dq0, moved = np.eye(4)
    dq = (1.5 * move - 0.5 * moved) / dt
    # The cubic p(u) over u in [0, 1], as coefficients of 1, u, u^2 and u^3.
    cubic = np.array((place, dt * dq0, 3.0 * move - dt * (2.0 * dq0 + dq), dt * (dq0 + dq) - 2.0 * move))
    u = np.arange(substeps + 1)[:, None] / substeps
    one, nil = np.ones_like(u), np.zeros_like(u)
    positions = np.hstack((one, u, u**2, u**3)) @ cubic
    velocities = np.hstack((nil, one, 2.0 * u, 3.0 * u**2)) @ cubic / dt
    accelerations = np.array(((0.0, 0.0, 2.0, 0.0), (0.0, 0.0, 2.0, 6.0))) @ cubic / dt**2
    return np.vstack((positions[:-1], velocities[1:], dq, accelerations))
