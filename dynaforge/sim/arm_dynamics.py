"""Inverse dynamics and Jacobian of the arm, with the masses and inertias that Bullet simulates."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from dynaforge.geometry import Array, JointTrajectory
from dynaforge.sim.bullet import connect, joints_and_links
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.hand import weigh_fingers
from dynaforge.sim.robot import RobotDescription


class ArmDynamics:
    """The arm's equation of motion, M(q) ddq + h(q, dq) = tau, with its hand half open and empty.

    Masses and centres of mass are those of the URDF, except in the hand (`weigh_fingers`). The moments of inertia are
    those that Bullet computes from the collision shapes, because the URDF's own (0.1 kg m^2 for every link) are
    placeholders. Bullet and this model therefore agree to rounding.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._model = _model(robot.urdf, robot.arm_joints, robot.finger_joints, robot.width_max)
        self._data = self._model.createData()
        self._frame = self._model.getFrameId(robot.ee_link)

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the joint torques that a motion needs without contact, Nm, shape (7,).

        Args:
            q: Joint positions, radians, shape (7,).
            dq: Joint velocities, rad/s, shape (7,).
            ddq: Joint accelerations, rad/s^2, shape (7,).
        """
        torque: Array = pin.rnea(self._model, self._data, q, dq, ddq)
        return torque.copy()

    def along_line(self, q: Array, tangent: Array) -> tuple[Array, Array, Array]:
        """Return the torques at points of a straight edge, shape (n, 7) each.

        Args:
            q: Joint positions on the edge, radians, shape (n, 7).
            tangent: Change of the joints per path length, shape (7,).

        Returns:
            Of the weight, Nm; per path acceleration; per squared path speed.
        """
        still = np.zeros_like(tangent)
        weight = np.array([self.torque(point, still, still) for point in q])
        inertia = np.array([self.torque(point, still, tangent) for point in q]) - weight
        return weight, inertia, np.array([self.torque(point, tangent, still) for point in q]) - weight

    def torques(self, trajectory: JointTrajectory) -> tuple[Array, Array]:
        """Return the torques of the weight alone and of the motion at every sample, Nm, shape (n, 7) each."""
        still = np.zeros(trajectory.q.shape[1])
        samples = zip(trajectory.q, trajectory.dq, trajectory.ddq, strict=True)
        rows = [(self.torque(q, still, still), self.torque(q, dq, ddq)) for q, dq, ddq in samples]
        weight, moving = np.array(rows).swapaxes(0, 1)
        return weight, moving

    def jacobian(self, q: Array) -> Array:
        """Return the end effector's Jacobian in world axes, shape (6, 7): linear rows (m/rad), then angular ones."""
        jacobian: Array = pin.computeFrameJacobian(
            self._model, self._data, q, self._frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return jacobian


@lru_cache(maxsize=4)
def _model(urdf: Path, arm_joints: tuple[str, ...], finger_joints: tuple[str, str], width_max: float) -> Any:
    model = pin.buildModelFromUrdf(str(urdf))
    for joint in range(1, model.njoints):
        model.inertias[joint] = pin.Inertia.Zero()
    links = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint}
    for name, inertia in _link_inertias(urdf, finger_joints).items():
        if name in links:
            joint = links[name].parentJoint
            model.inertias[joint] = model.inertias[joint] + links[name].placement.act(inertia)
    locked = [name for name in model.names[1:] if name not in arm_joints]
    q = pin.neutral(model)
    for name in locked:
        q[model.joints[model.getJointId(name)].idx_q] = width_max / 4
    return pin.buildReducedModel(model, [model.getJointId(name) for name in locked], q)


def _link_inertias(urdf: Path, finger_joints: tuple[str, str]) -> dict[str, Any]:
    """Return what Bullet takes for the mass, centre of mass and inertia of every link that has a mass, by name."""
    client = connect(gui=False)
    body = client.loadURDF(str(urdf), useFixedBase=True, flags=p.URDF_IGNORE_VISUAL_SHAPES)
    joints, links = joints_and_links(client, body)
    weigh_fingers(client, body, [joints[name] for name in finger_joints])
    inertias = {}
    for name, link in links.items():
        mass, _, moments, centre, turn, *_ = client.getDynamicsInfo(body, link)
        if mass:
            rotation = np.array(p.getMatrixFromQuaternion(turn)).reshape(3, 3)
            inertias[name] = pin.Inertia(mass, np.array(centre), rotation @ np.diag(moments) @ rotation.T)
    client.disconnect()
    return inertias
