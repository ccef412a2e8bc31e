"""The configurations of a Franka arm that place its hand at a pose, in closed form.

The seventh joint is free: given its angle, the wrist centre is known, the distance from shoulder to wrist gives the
fourth joint, the angle between forearm and wrist axis the sixth, and the orientations along the chain the others (the
idea of He and Liu, 2021). Frames are those of Franka's documentation (modified Denavit-Hartenberg); the URDF of the
Panda uses the same.
"""

from __future__ import annotations

import math

import numpy as np

from dynaforge.geometry import Array, Pose

SHOULDER = np.array((0.0, 0.0, 0.333))  # metres, where the axes of joints 1 and 2 meet
UPPER_ARM = 0.316  # metres along the axis of joint 3, shoulder to elbow
FOREARM = 0.384  # metres along the axis of joint 5, elbow to wrist centre
ELBOW_OFFSET = 0.0825  # metres between the axis of joint 4 and those of joints 3 and 5
WRIST_OFFSET = 0.088  # metres between the axes of joints 6 and 7

# The squared distance from shoulder to wrist centre is _FAR - 2 _REACH cos(q4 - _BEND).
_ALONG, _ASIDE = ELBOW_OFFSET**2 - UPPER_ARM * FOREARM, ELBOW_OFFSET * (UPPER_ARM + FOREARM)
_REACH, _BEND = math.hypot(_ALONG, _ASIDE), math.atan2(_ASIDE, _ALONG)
_FAR = 2.0 * ELBOW_OFFSET**2 + UPPER_ARM**2 + FOREARM**2


def franka_configurations(T_world_7: Pose, q7: Array, *, lower: Array, upper: Array) -> Array:
    """Return the configurations inside the joint limits in which the frame of the last joint has a pose.

    Args:
        T_world_7: Wanted pose of the frame of joint 7, which turns with it.
        q7: Angles of joint 7 to solve for, radians, shape (n,).
        lower: Lower joint limits, radians, shape (7,).
        upper: Upper joint limits, radians, shape (7,); less than a full turn above the lower ones.

    Returns:
        Joint positions, radians, shape (m, 7); up to eight for each angle, in a fixed order. Empty if there are none.
    """
    with np.errstate(invalid="ignore", divide="ignore"):  # what is out of reach becomes NaN, which is in no limits
        found = _solve(T_world_7, q7)
        middle = (lower + upper) / 2.0
        found = middle + np.remainder(found - middle + np.pi, 2.0 * np.pi) - np.pi
        return found[((found >= lower) & (found <= upper)).all(axis=1)]


def _solve(T_world_7: Pose, q7: Array) -> Array:
    """Follow the module's description; arrays have the shape (2 elbows, 2 wrists, n[, 3]) until the shoulder."""
    x6, y6 = _wrist_axes(T_world_7.rotation, q7)
    to_shoulder = SHOULDER - (T_world_7.position - WRIST_OFFSET * x6)  # from the wrist centre, shape (n, 3)
    bend = np.arccos((_FAR - np.einsum("ni,ni->n", to_shoulder, to_shoulder)) / (2.0 * _REACH))
    q4 = (_BEND + np.stack((bend, -bend)))[:, None]
    c4, s4 = np.cos(q4), np.sin(q4)
    along = ELBOW_OFFSET * s4 - UPPER_ARM * c4 - FOREARM  # of the vector to the shoulder, on the forearm's axis z5
    across = ELBOW_OFFSET * (1.0 - c4) - UPPER_ARM * s4  # and on x4, at right angles to it
    x, y = np.einsum("ni,ni->n", to_shoulder, x6), np.einsum("ni,ni->n", to_shoulder, y6)
    turn = np.arccos(along[:, 0] / np.hypot(x, y))
    q6 = np.arctan2(x, y) + np.stack((turn, -turn), axis=1)
    c6, s6 = np.cos(q6)[..., None], np.sin(q6)[..., None]
    z5, x5 = s6 * x6 + c6 * y6, c6 * x6 - s6 * y6
    x4 = (to_shoulder - along[..., None] * z5) / across[..., None]
    z4 = np.cross(x4, z5)
    q5 = np.arctan2(-np.einsum("...i,...i", x5, z4), np.einsum("...i,...i", x5, x4))
    x3, z3 = c4[..., None] * x4 - s4[..., None] * z5, s4[..., None] * x4 + c4[..., None] * z5
    q7 = np.broadcast_to(q7, q6.shape)
    q4 = np.broadcast_to(q4, q6.shape)
    return np.concatenate([_shoulder(x3, z3, (q4, q5, q6, q7), side) for side in (1.0, -1.0)])


def _wrist_axes(rotation: Array, q7: Array) -> tuple[Array, Array]:
    """Return the axes x and y of the frame of joint 6, shape (n, 3) each."""
    c, s = np.cos(q7)[:, None], np.sin(q7)[:, None]
    x7, y7, z7 = rotation.T
    return c * x7 - s * y7, np.broadcast_to(-z7, (len(q7), 3))


def _shoulder(x3: Array, z3: Array, rest: tuple[Array, ...], side: float) -> Array:
    """Find joints 1 to 3 from two axes of the upper arm; joint 2 bends to the given side. Shape (m, 7)."""
    q1 = np.arctan2(side * z3[..., 1], side * z3[..., 0])
    c1, s1 = np.cos(q1), np.sin(q1)
    lean = c1 * z3[..., 0] + s1 * z3[..., 1]
    q2 = np.arctan2(lean, z3[..., 2])
    x2 = np.stack((c1 * z3[..., 2], s1 * z3[..., 2], -lean), axis=-1)
    q3 = np.arctan2(c1 * x3[..., 1] - s1 * x3[..., 0], np.einsum("...i,...i", x3, x2))
    q4, q5, q6, q7 = rest
    return np.stack([q.ravel() for q in (q1, q2, q3, q4, q5, q6, q7)], axis=1)
