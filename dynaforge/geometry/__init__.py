"""Poses, rotations, joint states and trajectories, in pure numpy."""

from dynaforge.geometry.one_line import one_line
from dynaforge.geometry.pose import (
    Array,
    Pose,
    matrix_from_quat,
    matrix_from_rotation_6d,
    matrix_from_rotvec,
    quat_from_matrix,
    rotation_6d_from_matrix,
    rotation_z,
    rotvec_from_matrix,
)
from dynaforge.geometry.trajectory import JointState, JointTrajectory

__all__ = [
    "Array",
    "JointState",
    "JointTrajectory",
    "Pose",
    "matrix_from_quat",
    "matrix_from_rotation_6d",
    "matrix_from_rotvec",
    "one_line",
    "quat_from_matrix",
    "rotation_6d_from_matrix",
    "rotation_z",
    "rotvec_from_matrix",
]
