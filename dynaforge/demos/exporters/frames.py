"""Episodes as learners want them: robot state, object state, pictures, actions, one row a control step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.episode import Episode
from dynaforge.demos.observations import ObservationFolder
from dynaforge.geometry import Array

Floats = NDArray[np.float32]
ACTIONS = ("ee", "joint")
STATE = ("ee_position", "ee_quat_wxyz", "width", "q")
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
JOINTS = tuple(f"joint_{k}" for k in range(1, 8))
STATE_NAMES = (*POSE, "width", *JOINTS)
ACTION_NAMES = {"ee": (*POSE, "width"), "joint": (*JOINTS, "width")}


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """One episode; leading dimension T.

    Attributes:
        id: Of the episode.
        success: Whether it is one.
        fps: Control steps a second.
        robot: `ee_position` (3), `ee_quat_wxyz` (4), `width` (1), `q` (7), `dq` (7), float32.
        objects: `<name>_position`, `<name>_quat_wxyz`, `<name>_velocity`, `<name>_angular_velocity`, float32.
        actions: What the controller was asked for, float32: target pose of the end effector in the base frame
            (position, quaternion w, x, y, z) and gripper width, or joint positions and gripper width.
        action_names: Of its components.
        rewards: float32.
        images: RGB by camera, (H, W, 3) uint8 each; empty unless rendered.
        points: (P, 3) float32, metres, world frame; None unless rendered.
        point_colors: (P, 3) uint8; None unless rendered.
        episode: What it was made from.
    """

    id: str
    success: bool
    fps: int
    robot: Mapping[str, Floats]
    objects: Mapping[str, Floats]
    actions: Floats
    action_names: tuple[str, ...]
    rewards: Floats
    images: Mapping[str, NDArray[np.uint8]]
    points: Floats | None
    point_colors: NDArray[np.uint8] | None
    episode: Episode

    def __len__(self) -> int:
        return len(self.actions)

    @property
    def state(self) -> Floats:
        """What the robot knows of itself: end-effector pose, width, joint positions; shape (T, 15)."""
        return np.concatenate([self.robot[name] for name in STATE], axis=1)

    @property
    def object_state(self) -> Floats:
        """Poses and twists of all objects and fixtures side by side, shape (T, 13 n)."""
        return np.concatenate(list(self.objects.values()), axis=1)

    @property
    def object_names(self) -> list[str]:
        """Names of the components of `object_state`."""
        return [f"{key}_{k}" for key, column in self.objects.items() for k in range(column.shape[1])]


def read_frames(
    dataset: DemonstrationDataset,
    *,
    fps: int,
    actions: str = "ee",
    observations: ObservationFolder | None = None,
    failures: bool = False,
) -> Iterator[Frames]:
    """Iterate over the episodes of a dataset, in the order of their ids.

    Args:
        dataset: Where they are.
        fps: Control steps a second.
        actions: "ee" or "joint".
        observations: Rendered pictures and points to go with them.
        failures: Failed episodes too.

    Raises:
        ValueError: Unknown actions, or observations of an episode that were rendered from another recording.
        FileNotFoundError: An episode was not rendered.
    """
    if actions not in ACTIONS:
        raise ValueError(f"Actions are one of {', '.join(ACTIONS)}, not {actions!r}.")
    for episode in dataset:
        if len(episode) and (episode.success or failures):
            seen = observations.of(episode) if observations is not None else {}
            yield _frames(episode, seen, fps=fps, actions=actions)


def _frames(episode: Episode, seen: Mapping[str, NDArray[Any]], *, fps: int, actions: str) -> Frames:
    steps = episode.steps
    quat = without_jumps(steps["ee_quat_wxyz"])
    robot = {
        "ee_position": steps["ee_position"], "ee_quat_wxyz": quat, "width": steps["width"][:, None],
        "q": steps["q"], "dq": steps["dq"],
    }  # fmt: skip
    objects = {}
    for key, column in steps.items():
        kind, _, rest = key.partition("/")
        if kind in ("object", "fixture"):
            name = rest.replace("/", "_")
            objects[name] = without_jumps(column) if name.endswith("_quat_wxyz") else column
    if actions == "ee":
        asked = steps["projected_action"].copy()
        asked[:, 3:7] *= np.where((asked[:, 3:7] * quat).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    else:
        asked = np.column_stack((steps["joint_reference"], steps["width_reference"]))
    return Frames(
        id=episode.id,
        success=episode.success,
        fps=fps,
        robot={name: column.astype(np.float32) for name, column in robot.items()},
        objects={name: column.astype(np.float32) for name, column in objects.items()},
        actions=asked.astype(np.float32),
        action_names=ACTION_NAMES[actions],
        rewards=steps["reward"].astype(np.float32),
        images={key.removesuffix("/rgb"): column for key, column in seen.items() if key.endswith("/rgb")},
        points=seen["points"].astype(np.float32) if "points" in seen else None,
        point_colors=seen.get("point_colors"),
        episode=episode,
    )


def without_jumps(quat: Array) -> Array:
    """Choose the sign of each quaternion so that none jumps to its negative; shape (T, 4).

    A hand that points down has w = 0, where a sign fixed by w >= 0 would flip from step to step.
    """
    turned = (quat[1:] * quat[:-1]).sum(axis=1) < 0.0
    signs = np.where(np.concatenate(([False], turned)), -1.0, 1.0)
    return np.asarray(quat * np.cumprod(signs)[:, None])
