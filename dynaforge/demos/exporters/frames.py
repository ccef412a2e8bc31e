"""Episodes as learners want them: robot state, object state, pictures, actions, one row a control step."""

from __future__ import annotations

import difflib
import numbers
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.episode import Episode
from dynaforge.demos.episode_file import DamagedFileError
from dynaforge.demos.observations import ObservationFolder
from dynaforge.geometry import Array, matrix_from_quat, rotation_6d_from_matrix
from dynaforge.tasks import Task

Floats = NDArray[np.float32]
ACTIONS = ("ee", "joint")
ROTATIONS = ("quat_wxyz", "rotation_6d")
STATE = ("ee_position", "ee_quat_wxyz", "width", "q")
AXES = ("x", "y", "z")
QUAT = ("qw", "qx", "qy", "qz")
SIX = ("r1x", "r1y", "r1z", "r2x", "r2y", "r2z")
POSE = (*AXES, *QUAT)
JOINTS = tuple(f"joint_{k}" for k in range(1, 8))
STATE_NAMES = (*POSE, "width", *JOINTS)
ACTION_NAMES = {"ee": (*POSE, "width"), "joint": (*JOINTS, "width")}
CONTACTS = ("left", "right")
ROBOT_NAMES = {"ee_position": AXES, "ee_quat_wxyz": QUAT, "width": ("width",), "q": JOINTS, "dq": JOINTS}
"""Names of the components of each quantity in `Frames.robot`."""


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """One episode; leading dimension T.

    Attributes:
        id: Of the episode.
        success: Whether it is one.
        fps: Control steps a second.
        robot: `ee_position` (3), `ee_quat_wxyz` (4), `width` (1), `q` (7), `dq` (7), float32.
        objects: `<name>_position`, `<name>_quat_wxyz`, `<name>_velocity`, `<name>_angular_velocity`, float32: the
            truth, which no sensor tells so well.
        privileged: Whether an export holds the truth about objects.
        actions: What the controller was asked for, float32: target pose of the end effector in the base frame
            (position, then rotation) and gripper width, or joint positions and gripper width.
        action_names: Of its components.
        action_mode: "ee" or "joint".
        rotation: Of an "ee" action: "quat_wxyz" (w, x, y, z), or "rotation_6d", the first two columns of the rotation
            matrix one after the other, which jumps nowhere.
        rewards: float32.
        phase: Index of the phase that acted, int64; -1 where no phase program did.
        gate: The residual gate m, bool.
        contact: Whether the left and the right finger touch the manipulated object, (2) bool; False too where it was
            not recorded.
        images: RGB by camera, (H, W, 3) uint8 each; empty unless rendered.
        depths: Distance along the optical axis by camera, tenths of a millimetre, (H, W) uint16 each; likewise.
        points: (P, 3) float32, metres, world frame; None unless rendered.
        point_colors: (P, 3) uint8; None unless rendered.
        episode: What it was made from.
    """

    id: str
    success: bool
    fps: int
    robot: Mapping[str, Floats]
    objects: Mapping[str, Floats]
    privileged: bool
    actions: Floats
    action_names: tuple[str, ...]
    action_mode: str
    rotation: str
    rewards: Floats
    phase: NDArray[np.int64]
    gate: NDArray[np.bool_]
    contact: NDArray[np.bool_]
    images: Mapping[str, NDArray[np.uint8]]
    depths: Mapping[str, NDArray[np.uint16]]
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
        """Names of the components of `object_state`, e.g. "can_position_x"."""
        return [f"{key}_{axis}" for key in self.objects for axis in axes_of(key)]

    def env_arguments(self, task: Task) -> dict[str, str]:
        """Return what `gymnasium.make` takes besides the id of `env_of` to make the env that the actions belong to."""
        return {"action_mode": self.action_mode}


def env_of(task: Task) -> str:
    """Return the id of the env that a task's exported actions belong to, e.g. "DynaForge/CanTask-v0"."""
    return f"DynaForge/{task.env_name}Task-v0"


def axes_of(key: str) -> tuple[str, ...]:
    """Return the names of the components of a quantity in `Frames.objects`."""
    return ("w", *AXES) if key.endswith("_quat_wxyz") else AXES


def read_frames(
    dataset: DemonstrationDataset,
    *,
    fps: int,
    actions: str = "ee",
    rotation: str = "quat_wxyz",
    observations: ObservationFolder | None = None,
    depth: bool = True,
    privileged: bool | None = None,
    failures: bool = False,
) -> Iterator[Frames]:
    """Iterate over the episodes of a dataset, in the order of their ids.

    Args:
        dataset: Where they are.
        fps: Control steps a second, as they were recorded.
        actions: "ee" or "joint".
        rotation: Of an "ee" action: "quat_wxyz" or "rotation_6d".
        observations: Rendered pictures and points to go with them.
        depth: Depth maps too.
        privileged: Whether an export is to hold the truth about objects; by default where there is nothing rendered
            to see them by.
        failures: Failed episodes too.

    Raises:
        ValueError: Unknown actions or rotation, fps that are no whole number above 0 or not those of the recording, or
            observations of an episode that were rendered from another recording.
        FileNotFoundError: An episode was not rendered.
    """
    _one_of(ACTIONS, actions, "Actions")
    _one_of(ROTATIONS, rotation, "Rotations")
    if actions == "joint" and rotation != ROTATIONS[0]:
        raise ValueError(f"Joint positions have no rotation; leave {rotation!r} out, or take actions 'ee'.")
    if not isinstance(fps, numbers.Integral) or isinstance(fps, bool) or fps < 1:
        raise ValueError(f"fps is a whole number of control steps a second, at least 1, e.g. 30; given {fps!r}.")
    kind = _Kind(int(fps), actions, rotation, depth, privileged if privileged is not None else observations is None)
    return _read(dataset, observations, failures, kind)


@dataclass(frozen=True, slots=True)
class _Kind:
    """What is read of an episode, as `read_frames` takes it."""

    fps: int
    actions: str
    rotation: str
    depth: bool
    privileged: bool


def _read(
    dataset: DemonstrationDataset, observations: ObservationFolder | None, failures: bool, kind: _Kind
) -> Iterator[Frames]:
    for episode in dataset:
        if len(episode) and (episode.success or failures):
            _check_rate(episode, kind.fps)
            yield _frames(episode, observations, kind)  # nothing here keeps the pictures alive


def _one_of(known: tuple[str, ...], given: str, what: str) -> None:
    if given not in known:
        close = difflib.get_close_matches(str(given), known, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise ValueError(f"{what} are one of {', '.join(known)}, not {given!r}.{hint}")


def _check_rate(episode: Episode, fps: int) -> None:
    """Make sure that the rate given is that of the recording, which carries its times."""
    times = episode.steps["time"]
    if len(times) > 1 and fps != (recorded := round(1.0 / float(np.median(np.diff(times))))):
        raise ValueError(f"Episode {episode.id} was recorded at {recorded} control steps a second, not {fps}.")


def _frames(episode: Episode, observations: ObservationFolder | None, kind: _Kind) -> Frames:
    steps, n = episode.steps, len(episode)
    quat = without_jumps(steps["ee_quat_wxyz"])
    robot = {
        "ee_position": steps["ee_position"], "ee_quat_wxyz": quat, "width": steps["width"][:, None],
        "q": steps["q"], "dq": steps["dq"],
    }  # fmt: skip
    nothing = np.zeros(n, dtype=bool)
    seen = _seen(observations, episode)
    asked, names = _asked(episode, quat, kind)
    return Frames(
        id=episode.id,
        success=episode.success,
        fps=kind.fps,
        robot={name: column.astype(np.float32) for name, column in robot.items()},
        objects=_objects(steps),
        privileged=kind.privileged,
        actions=asked.astype(np.float32),
        action_names=names,
        action_mode=kind.actions,
        rotation=kind.rotation if kind.actions == "ee" else "",
        rewards=steps["reward"].astype(np.float32),
        phase=steps.get("phase", np.full(n, -1)).astype(np.int64),
        gate=steps.get("gate", nothing),
        contact=np.column_stack([steps.get(f"{side}_contact", nothing) for side in CONTACTS]),
        images=seen["rgb"],
        depths=seen["depth"] if kind.depth else {},
        points=seen["points"],
        point_colors=seen["point_colors"],
        episode=episode,
    )


def _asked(episode: Episode, quat: Array, kind: _Kind) -> tuple[Array, tuple[str, ...]]:
    """Return the actions of an episode and the names of their components."""
    steps = episode.steps
    if kind.actions == "joint":
        return np.column_stack((steps["joint_reference"], steps["width_reference"])), ACTION_NAMES["joint"]
    target = steps["projected_action"]
    if kind.rotation == "rotation_6d":
        six = np.array([rotation_6d_from_matrix(matrix_from_quat(row)) for row in target[:, 3:7]])
        return np.column_stack((target[:, :3], six, target[:, 7])), (*AXES, *SIX, "width")
    near = np.where((target[:, 3:7] * quat).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0) * target[:, 3:7]
    return np.column_stack((target[:, :3], near, target[:, 7])), ACTION_NAMES["ee"]


def _objects(steps: Mapping[str, NDArray[Any]]) -> dict[str, Floats]:
    objects = {}
    for key, column in steps.items():
        kind, _, rest = key.partition("/")
        if kind in ("object", "fixture"):
            name = rest.replace("/", "_")
            held = without_jumps(column) if name.endswith("_quat_wxyz") else column
            objects[name] = held.astype(np.float32)
    return objects


def _seen(observations: ObservationFolder | None, episode: Episode) -> dict[str, Any]:
    """Return what was rendered: pictures and depth by camera, points and their colours.

    Cameras are those of the settings, whose names are checked; in a file may stand any.
    """
    if observations is None:
        return {"rgb": {}, "depth": {}, "points": None, "point_colors": None}
    settings, arrays = observations.settings, observations.of(episode)
    cameras = [camera.name for camera in settings.cameras] if settings.images else []
    clouds = ["points", "point_colors"] if settings.points else []
    for name in (*(f"{camera}/{kind}" for camera in cameras for kind in ("rgb", "depth")), *clouds):
        if name not in arrays or len(arrays[name]) != len(episode):
            reason = f"it does not hold {name!r} of {len(episode)} control steps"
            raise DamagedFileError(observations.file_of(episode.id), reason, again="render")
    return {
        "rgb": {name: arrays[f"{name}/rgb"] for name in cameras},
        "depth": {name: arrays[f"{name}/depth"] for name in cameras},
        "points": arrays["points"].astype(np.float32) if clouds else None,
        "point_colors": arrays["point_colors"] if clouds else None,
    }


def without_jumps(quat: Array) -> Array:
    """Choose the sign of each quaternion so that none jumps to its negative; shape (T, 4).

    A hand that points down has w = 0, where a sign fixed by w >= 0 would flip from step to step.
    """
    turned = (quat[1:] * quat[:-1]).sum(axis=1) < 0.0
    signs = np.where(np.concatenate(([False], turned)), -1.0, 1.0)
    return np.asarray(quat * np.cumprod(signs)[:, None])
