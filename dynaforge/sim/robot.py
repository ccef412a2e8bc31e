"""The description of the robot: geometry of the Panda, limits of the Franka Research 3."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaforge.geometry import Array, one_line
from dynaforge.sim.checks import check_kind, check_number, check_text, check_tuple, finite_array, quoted
from dynaforge.sim.speed_limits import SpeedLimits

HAND_WIDTH = 0.08  # metres, fully open
ELBOW = 2
"""Index of the joint whose angle describes the elbow, as in Franka's own Cartesian interface."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RobotDescription:
    """Everything about the robot that physics and planning must agree on.

    The end-effector frame `ee` sits between the finger pads: its z axis points out of the hand, its y axis is the
    direction in which the fingers open. The base frame is the world frame; the table top is at z = 0.

    Attributes:
        urdf: Path of the robot's URDF.
        arm_joints: Names of the seven arm joints, base to wrist.
        finger_joints: Names of the two finger joints.
        ee_link: Link whose frame is the end-effector frame.
        q_lower, q_upper: Position limits, radians, shape (7,). The speed limits leave a speed up to both.
        speed_limits: Velocity limits, which depend on position: `speed_limits(q)` returns the least and the greatest
            velocity of each joint at q. Every reference of the arm keeps them.
        ddq_max, dddq_max: Acceleration and jerk limits, rad/s^2, rad/s^3, shape (7,).
        stop_speed: The robot stops itself, as the reflex of the real arm does, when a measured joint speed exceeds this
            multiple of `dq_max`. A servo may overshoot the limit a little; a jammed hand that breaks free exceeds it.
            It is not measured against the limit at that position, which is 0 at an end: the real arm holds only the
            command to that.
        q_ready: The joint positions from which every episode starts, radians, shape (7,).
        effort_max: Joint torque limits, Nm, shape (7,).
        torque_margin: How much torque a motor gives at most beyond what its reference needs, Nm, shape (7,).
        width_max: Largest opening between the fingers, metres.
        finger_speed_max: Speed limit of one finger, m/s; the width changes at most twice as fast.
        grip_force: Force with which each finger closes on an object, newtons.
    """

    urdf: Path
    arm_joints: tuple[str, ...]
    finger_joints: tuple[str, str]
    ee_link: str
    q_lower: Array
    q_upper: Array
    speed_limits: SpeedLimits
    ddq_max: Array
    dddq_max: Array
    q_ready: Array
    effort_max: Array
    torque_margin: Array
    stop_speed: float = 1.5
    width_max: float = HAND_WIDTH
    finger_speed_max: float = 0.05
    grip_force: float = 40.0

    __repr__ = one_line

    def __post_init__(self) -> None:
        check_kind("RobotDescription: urdf", self.urdf, (str, Path))
        for name, n in (("arm_joints", 7), ("finger_joints", 2)):
            if len(check_tuple(f"RobotDescription: {name}", getattr(self, name), str)) != n:
                raise ValueError(f"RobotDescription: {name} is {quoted(getattr(self, name))}; it must be {n} names.")
        check_text("RobotDescription: ee_link", self.ee_link)
        for name in ("q_lower", "q_upper", "q_ready", "ddq_max", "dddq_max", "effort_max", "torque_margin"):
            values = finite_array(f"RobotDescription: {name}", getattr(self, name), (7,))
            object.__setattr__(self, name, values)
            if ("max" in name or "margin" in name) and (values <= 0.0).any():
                raise ValueError(f"RobotDescription: {name} is {quoted(values.tolist())}; limits are above 0.")
        if not (self.q_lower < self.q_upper).all():
            raise ValueError("RobotDescription: q_lower is not below q_upper in every joint.")
        check_kind("RobotDescription: speed_limits", self.speed_limits, SpeedLimits)
        if not ((self.speed_limits(self.q_lower)[0] < 0.0) & (self.speed_limits(self.q_upper)[1] > 0.0)).all():
            raise ValueError("RobotDescription: a joint cannot get to q_lower and q_upper within speed_limits.")
        for name in ("stop_speed", "width_max", "finger_speed_max", "grip_force"):
            check_number(f"RobotDescription: {name}", getattr(self, name), above=0.0)

    @property
    def dq_max(self) -> Array:
        """The greatest speed of each joint at any position, rad/s, shape (7,)."""
        return self.speed_limits.cap


def franka() -> RobotDescription:
    """Describe the Panda of `pybullet_data` (Apache-2.0) with the limits of the Franka Research 3.

    Sources: Franka Robotics, FCI documentation, "Limits for Franka Research 3", and libfranka, `rate_limiting.h`
    (velocity as a function of position, 10 rad/s^2, 5000 rad/s^3); FR3 datasheet (position). Position limits are a few
    milliradians inside the datasheet's, so that up to them 0.02 rad/s are allowed, and so that joint 5, whose velocity
    limit falls faster than the joint may brake, keeps it whenever it can stop before its position limit. Joint 6 stops
    at 3.75 rad, where the Panda's own geometry ends, and not at the FR3's 4.52, and joint 7 at the Panda's 2.8973.
    """
    import pybullet_data  # type: ignore[import-untyped, unused-ignore]

    return RobotDescription(
        urdf=Path(pybullet_data.getDataPath()) / "franka_panda" / "panda.urdf",
        arm_joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
        finger_joints=("panda_finger_joint1", "panda_finger_joint2"),
        ee_link="panda_grasptarget",
        q_lower=np.array((-2.7415, -1.7824, -2.8995, -3.0353, -2.8013, 0.5534, -2.8973)),
        q_upper=np.array((2.7415, 1.7824, 2.8995, -0.1586, 2.8013, 3.75, 2.8973)),
        speed_limits=SpeedLimits(
            cap=np.array((2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26)),
            offset=np.array((0.3, 0.2, 0.2, 0.3, 0.35, 0.35, 0.35)),
            gain=np.array((12.0, 5.17, 7.0, 8.0, 34.0, 11.0, 34.0)),
            lower=np.array((-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196)),
            upper=np.array((2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196)),
        ),
        ddq_max=np.full(7, 10.0),
        dddq_max=np.full(7, 5000.0),
        q_ready=np.array((0.0, 0.0, 0.0, -2.2, 0.0, 2.2, 0.785)),
        effort_max=np.array((87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)),
        # Half of the lowest collision thresholds in use: enough for a load of 0.4 kg at arm's length (2.4 Nm) and for
        # starts and stops, and little enough that a hand 2.5 cm past contact presses with less than 80 N.
        torque_margin=np.array((8.0, 8.0, 8.0, 8.0, 5.0, 5.0, 5.0)),
    )
