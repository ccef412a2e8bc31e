"""Joint torques of the arm by Pinocchio's inverse dynamics."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dynaforge.geometry import Array, JointTrajectory
from dynaforge.planning.kinematics import load_model
from dynaforge.sim.robot import RobotDescription


class ArmDynamics:
    """Torques of the arm with an empty, open hand.

    Args:
        robot: Geometry and masses.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._model, _ = load_model(robot.urdf, robot.arm_joints, robot.width_max)
        self._data = self._model.createData()

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

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torques of a motion at joint positions, speeds and accelerations, Nm, shape (7,) each."""
        torque: Array = pin.rnea(self._model, self._data, q, dq, ddq).copy()
        return torque
