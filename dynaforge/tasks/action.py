"""Absolute actions, defined once for recordings, exports, packs and `TaskEnv`.

An action is where the controller should be at the end of the control step: the joint positions of its reference, or the
hand's pose there, and the gripper's width. A target that the limits allow is reached exactly within the step, so the
actions of a recording have the same effect in `TaskEnv` as in the recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from dynaforge.geometry import (
    Array,
    Pose,
    matrix_from_quat,
    matrix_from_rotation_6d,
    matrix_from_rotvec,
    rotation_6d_from_matrix,
    rotvec_from_matrix,
)
from dynaforge.sim import HandTarget
from dynaforge.sim.checks import check_choice, check_flag
from dynaforge.sim.robot import ELBOW
from dynaforge.tasks.targets import DOWN_ALONG_X

ActionMode = Literal["ee", "joint"]
RotationForm = Literal["quat_wxyz", "rotvec", "rotation_6d"]
ACTION_MODES: tuple[ActionMode, ...] = get_args(ActionMode)
ROTATIONS: Mapping[RotationForm, tuple[str, ...]] = {
    "quat_wxyz": ("qw", "qx", "qy", "qz"),
    "rotvec": ("rx", "ry", "rz"),
    "rotation_6d": ("r1x", "r1y", "r1z", "r2x", "r2y", "r2z"),
}
JOINTS = tuple(f"joint_{k}" for k in range(1, 8))
WORKSPACE = ((-0.3, -0.9, -0.02), (0.9, 0.9, 1.1))  # lowest and highest position, metres


@dataclass(frozen=True, slots=True)
class ActionLayout:
    """Which numbers an action consists of, and in which order.

    mode "ee": position (m, base frame), rotation, gripper width (m), and with `elbow` the angle of the third joint
    (rad). mode "joint": seven joint positions (rad) and gripper width (m).

    Attributes:
        mode: "ee" or "joint".
        rotation: "quat_wxyz": a quaternion of any length except zero. "rotvec": the rotation vector from the hand that
            points straight down, radians, which jumps near a half turn. "rotation_6d": two columns of the rotation
            matrix, which never jump.
        elbow: A pose leaves one degree of freedom of the arm undetermined. With the elbow's angle, as in Franka's own
            Cartesian interface, a recorded motion is reproduced exactly; without it, the arm stays as close as it can
            to where it is.

    Raises:
        ValueError: The mode or rotation is unknown, or `elbow` is set for joint positions.
    """

    mode: ActionMode = "ee"
    rotation: RotationForm = "quat_wxyz"
    elbow: bool = False

    def __post_init__(self) -> None:
        check_choice("action_mode", self.mode, ACTION_MODES)
        check_choice("rotation", self.rotation, ROTATIONS)
        check_flag("elbow", self.elbow)
        if self.elbow and self.mode == "joint":
            raise ValueError("Joint positions determine the elbow: elbow=True is for action_mode 'ee' only.")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components."""
        if self.mode == "joint":
            return (*JOINTS, "width")
        return ("x", "y", "z", *ROTATIONS[self.rotation], "width", *(("elbow",) if self.elbow else ()))

    @property
    def env_arguments(self) -> dict[str, Any]:
        """The arguments with which `TaskEnv`, or `gymnasium.make` of its id, takes such actions."""
        if self.mode == "joint":
            return {"action_mode": "joint"}
        return {"action_mode": "ee", "rotation": self.rotation, "elbow": self.elbow}

    def bounds(self, q_lower: Array, q_upper: Array, width_max: float) -> tuple[Array, Array]:
        """Return the least and the greatest value of every component, float32, shape (d,).

        Args:
            q_lower: Lower joint limits, radians, shape (7,).
            q_upper: Upper joint limits, radians, shape (7,).
            width_max: Largest opening between the fingers, metres.
        """
        if self.mode == "joint":
            low, high = [*q_lower, 0.0], [*q_upper, width_max]
        else:
            largest = np.pi if self.rotation == "rotvec" else 1.0
            rotation = [largest] * len(ROTATIONS[self.rotation])
            low = [*WORKSPACE[0], *(-x for x in rotation), 0.0]
            high = [*WORKSPACE[1], *rotation, width_max]
            if self.elbow:
                low, high = [*low, q_lower[ELBOW]], [*high, q_upper[ELBOW]]
        return _round_toward(low, -np.inf), _round_toward(high, np.inf)

    def hand_target(self, action: Array) -> HandTarget:
        """Return the target of the hand that an "ee" action stands for.

        Raises:
            ValueError: Its rotation is a quaternion of length zero.
        """
        return HandTarget(Pose(self._matrix(action), action[:3]), self.width(action))

    def width(self, action: Array) -> float:
        """Return the action's gripper width, metres."""
        return float(action[-2] if self.elbow else action[-1])

    def of_steps(self, steps: Mapping[str, Any]) -> Array:
        """Return the actions of a recording, shape (T, d).

        Args:
            steps: Recorded columns by name (`demos.schema`): `joint_reference`, `width_reference`, `projected_action`
                and `ee_quat_wxyz`.
        """
        if self.mode == "joint":
            return np.column_stack((steps["joint_reference"], steps["width_reference"]))
        pose = np.asarray(steps["projected_action"], dtype=np.float64)
        quats = pose[:, 3:7]
        measured = without_jumps(np.asarray(steps["ee_quat_wxyz"], dtype=np.float64))
        # The sign is that of the measured rotation, so that actions and states agree.
        quats = np.where((quats * measured).sum(axis=1, keepdims=True) < 0.0, -quats, quats)
        parts = [pose[:, :3], self._rotations(quats), pose[:, 7]]
        if self.elbow:
            parts.append(steps["joint_reference"][:, ELBOW])
        return np.column_stack(parts)

    def _matrix(self, action: Array) -> Array:
        numbers = action[3 : 3 + len(ROTATIONS[self.rotation])]
        if self.rotation == "rotvec":
            matrix: Array = matrix_from_rotvec(numbers) @ DOWN_ALONG_X
            return matrix
        if self.rotation == "rotation_6d":
            return matrix_from_rotation_6d(numbers)
        if not np.abs(numbers).max() > 1e-6:
            raise ValueError(f"A quaternion of length zero is not a rotation; got {numbers.tolist()}.")
        return matrix_from_quat(numbers)

    def _rotations(self, quats: Array) -> Array:
        if self.rotation == "quat_wxyz":
            return quats
        matrices = [matrix_from_quat(quat) for quat in quats]
        if self.rotation == "rotation_6d":
            return np.array([rotation_6d_from_matrix(matrix) for matrix in matrices])
        return np.array([rotvec_from_matrix(matrix @ DOWN_ALONG_X.T) for matrix in matrices])


def without_jumps(quats: Array) -> Array:
    """Choose the signs of quaternions, shape (T, 4), so that none jumps to its negative; the first one stays.

    A hand that points down has w near 0, where a sign chosen by w >= 0 would flip from step to step.
    """
    jumps = np.concatenate(([False], (quats[1:] * quats[:-1]).sum(axis=1) < 0.0))
    negated = np.logical_xor.accumulate(jumps)
    return np.asarray(quats * np.where(negated, -1.0, 1.0)[:, None])


def _round_toward(values: Any, direction: float) -> Array:
    """Round to float32 toward -inf or inf, so that joint positions at a limit are inside the bounds as float32."""
    exact = np.asarray(values, dtype=np.float64)
    rounded = exact.astype(np.float32)
    beyond = (rounded > exact) if direction < 0 else (rounded < exact)
    return np.where(beyond, np.nextafter(rounded, np.float32(direction)), rounded).astype(np.float32)
