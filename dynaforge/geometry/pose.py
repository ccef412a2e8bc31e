"""Rigid poses, whose names show that inner frames cancel when they are composed, and conversions of rotations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaforge.geometry.one_line import one_line

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid transform, named `T_a_b`: it turns coordinates in frame b into coordinates in frame a.

    Poses compose so that inner frames cancel: `T_world_ee = T_world_object @ T_object_ee`.

    Attributes:
        rotation: Rotation matrix, shape (3, 3).
        position: Origin of frame b in frame a, metres, shape (3,).
    """

    rotation: Array
    position: Array

    __repr__ = one_line

    @staticmethod
    def identity() -> Pose:
        """Return the pose that changes nothing."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_quat(position: ArrayLike, quat_wxyz: ArrayLike) -> Pose:
        """Build a pose from a position in metres, shape (3,), and a quaternion (w, x, y, z), shape (4,)."""
        return Pose(matrix_from_quat(quat_wxyz), np.array(position, dtype=np.float64))

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.rotation @ other.rotation, self.rotation @ other.position + self.position)

    def inverse(self) -> Pose:
        """Return `T_b_a` for this `T_a_b`."""
        transposed = self.rotation.T
        return Pose(transposed, -(transposed @ self.position))

    def apply(self, points: Array) -> Array:
        """Turn points in frame b, metres, shape (..., 3), into points in frame a."""
        return points @ self.rotation.T + self.position

    @property
    def quat_wxyz(self) -> Array:
        """The rotation as a unit quaternion (w, x, y, z) with w >= 0, shape (4,)."""
        return quat_from_matrix(self.rotation)


def matrix_from_quat(quat_wxyz: ArrayLike) -> Array:
    """Turn a quaternion (w, x, y, z), shape (4,), of any positive length, into a rotation matrix, shape (3, 3).

    It computes with plain floats, which is three times as fast as numpy on four numbers: this runs at every control
    step.
    """
    w, x, y, z = (float(c) for c in np.asarray(quat_wxyz))
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array(
        (
            (1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
            (s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)),
            (s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)),
        )
    )


def quat_from_matrix(rotation: Array) -> Array:
    """Turn a rotation matrix, shape (3, 3), into a unit quaternion (w, x, y, z) with w >= 0, shape (4,)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    # The largest of the four components is never near zero, so that the division by it is safe.
    squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)
    k = max(range(4), key=squares.__getitem__)
    r = math.sqrt(squares[k])
    s = 0.5 / r
    quat = (
        (0.5 * r, (h - f) * s, (c - g) * s, (d - b) * s),
        ((h - f) * s, 0.5 * r, (b + d) * s, (c + g) * s),
        ((c - g) * s, (b + d) * s, 0.5 * r, (f + h) * s),
        ((d - b) * s, (c + g) * s, (f + h) * s, 0.5 * r),
    )[k]
    return np.array(quat if quat[0] >= 0 else [-v for v in quat])


def matrix_from_rotvec(rotvec: ArrayLike) -> Array:
    """Turn a rotation vector, radians, shape (3,), into a rotation matrix, shape (3, 3), by Rodrigues' formula."""
    x, y, z = (float(c) for c in np.asarray(rotvec))
    angle2 = x * x + y * y + z * z
    angle = math.sqrt(angle2)
    if angle < 1e-8:
        a, b = 1.0, 0.5
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    return np.array(
        (
            (1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y),
            (b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x),
            (b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)),
        )
    )


def rotvec_from_matrix(rotation: Array) -> Array:
    """Turn a rotation matrix, shape (3, 3), into a rotation vector, radians, shape (3,), of length pi at most."""
    w, x, y, z = quat_from_matrix(rotation).tolist()
    n = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if n < 1e-12 else 2.0 * math.atan2(n, w) / n
    return np.array((scale * x, scale * y, scale * z))


def rotation_6d_from_matrix(rotation: Array) -> Array:
    """Return the first two columns of a rotation matrix, shape (3, 3), one after the other, shape (6,).

    Unlike quaternions and rotation vectors, these six numbers are continuous: none of them jumps near a half turn.
    """
    return np.concatenate((rotation[:, 0], rotation[:, 1]))


def matrix_from_rotation_6d(columns: ArrayLike) -> Array:
    """Turn two columns into a rotation matrix, shape (3, 3), by Gram-Schmidt.

    The first column keeps its direction, the second keeps its part perpendicular to the first, and their cross product
    is the third.

    Args:
        columns: First column, then second, of any positive length and not parallel, shape (6,).

    Raises:
        ValueError: They span no plane, so that there is no such rotation.
    """
    x, second = np.asarray(columns, dtype=np.float64).reshape(2, 3)
    lengths = np.linalg.norm(x), np.linalg.norm(second)
    if not np.linalg.norm(np.cross(x, second)) > 1e-8 * lengths[0] * lengths[1]:
        raise ValueError(
            f"A rotation needs two columns of three numbers, neither zero nor parallel; given {columns!r}."
        )
    x = x / lengths[0]
    y = second - (x @ second) * x
    y = y / np.linalg.norm(y)
    return np.column_stack((x, y, np.cross(x, y)))


def rotation_z(angle: float) -> Array:
    """Return the rotation about z by `angle` radians, shape (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
