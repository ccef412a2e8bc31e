"""The target of the hand: a pose and an opening, as one value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaforge.geometry import Array, Pose, matrix_from_rotvec, one_line
from dynaforge.sim.robot import RobotDescription

LOWEST_EE = 0.012  # metres above the table: the finger tips are 7 mm below the end-effector frame


@dataclass(frozen=True, slots=True, eq=False)
class HandTarget:
    """A target of the hand.

    Attributes:
        pose: Target of the end-effector pose, `T_world_ee`.
        width: Target of the opening between the fingers, metres.
    """

    pose: Pose
    width: float

    __repr__ = one_line

    def corrected(self, residual: Array) -> HandTarget:
        """Return the target with a residual added.

        Args:
            residual: Translation (m), rotation vector (rad) and width (m), shape (7,), in the axes of the world. The
                rotation turns the hand about its own origin.
        """
        rotation = self.pose.rotation
        if residual[3] or residual[4] or residual[5]:
            rotation = matrix_from_rotvec(residual[3:6]) @ rotation
        return HandTarget(Pose(rotation, self.pose.position + residual[:3]), self.width + float(residual[6]))

    def within_reach(self, robot: RobotDescription) -> HandTarget:
        """Return the nearest target with the fingers above the table and an opening within the hand's range."""
        pose = self.pose
        if pose.position[2] < LOWEST_EE:
            x, y, _ = pose.position.tolist()
            pose = Pose(pose.rotation, np.array((x, y, LOWEST_EE)))
        return HandTarget(pose, min(max(self.width, 0.0), robot.width_max))

    def flat(self) -> Array:
        """Return position (m), quaternion (w, x, y, z) and width (m) side by side, shape (8,)."""
        return np.concatenate((self.pose.position, self.pose.quat_wxyz, (self.width,)))
