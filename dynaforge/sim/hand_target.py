"""The target of the hand: a pose and an opening, as one value."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynaforge.geometry import Array, Pose, matrix_from_rotvec, one_line
from dynaforge.sim.robot import RobotDescription

TIP, PALM = 0.007, 0.039  # metres: the fingertips are so far below the end-effector frame, the palm so far above it
CLEARANCE = 0.005  # metres between the hand and the table
# The hand's lowest points in the end-effector frame, metres: the tips of open fingers, and the edges of the palm.
HAND_POINTS = np.array(
    [(x, y, TIP) for x in (-0.01, 0.01) for y in (-0.05, 0.05)]
    + [(x, y, -PALM) for x in (-0.03, 0.03) for y in (-0.1, 0.1)]
)


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

    def within_reach(self, robot: RobotDescription, *, lowest: float = -math.inf) -> HandTarget:
        """Return the nearest target with the hand above the table and an opening within the hand's range.

        Args:
            robot: The robot.
            lowest: Least height of the end effector in the world, metres.
        """
        lowest = max(lowest, CLEARANCE - min((HAND_POINTS @ self.pose.rotation[2]).tolist()))
        pose = raised_to(self.pose, lowest)
        return HandTarget(pose, min(max(self.width, 0.0), robot.width_max))

    def flat(self) -> Array:
        """Return position (m), quaternion (w, x, y, z) and width (m) side by side, shape (8,)."""
        return np.concatenate((self.pose.position, self.pose.quat_wxyz, (self.width,)))


def under_palm(top: float) -> float:
    """Return the least height of the end effector above an object's origin that keeps the palm off the object.

    Args:
        top: Height of its highest point above its origin, metres; the palm stays 3 mm above it.
    """
    return top + 0.003 - PALM


def raised_to(pose: Pose, height: float) -> Pose:
    """Return a pose, moved straight up to a height in the world if it is lower."""
    x, y, z = pose.position.tolist()
    return pose if z >= height else Pose(pose.rotation, np.array((x, y, height)))
