"""Episodes as learners need them: robot state, object state, pictures, actions, one row per control step."""

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
from dynaforge.demos.observations import ObservationFolder
from dynaforge.geometry import one_line
from dynaforge.tasks import Task
from dynaforge.tasks.action import (
    ACTION_MODES,
    JOINTS,
    ROTATIONS,
    ActionLayout,
    ActionMode,
    RotationForm,
    without_jumps,
)

Floats = NDArray[np.float32]
STATE = ("ee_position", "ee_quat_wxyz", "width", "q")
AXES = ("x", "y", "z")
QUAT = ROTATIONS["quat_wxyz"]
STATE_NAMES = (*AXES, *QUAT, "width", *JOINTS)
CONTACTS = ("left", "right")
ROBOT_NAMES = {"ee_position": AXES, "ee_quat_wxyz": QUAT, "width": ("width",), "q": JOINTS, "dq": JOINTS}
"""Names of the components of each quantity in `Frames.robot`."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frames:
    """One episode; leading dimension T.

    Attributes:
        fps: Control steps per second.
        robot: `ee_position` (3), `ee_quat_wxyz` (4), `width` (1), `q` (7), `dq` (7), float32.
        objects: `<name>_position`, `<name>_quat_wxyz`, `<name>_velocity`, `<name>_angular_velocity`, float32: the
            true state, which no sensor measures so well.
        privileged: Whether an export contains the true state of the objects.
        actions: Target of the controller for the end of the control step, float32.
        layout: Which numbers an action consists of.
        rewards: float32.
        phase: Index of the phase that acted, int64; -1 where no phase program ran.
        gate: The residual gate m, bool.
        contact: Whether the left and the right finger touch the manipulated object, (2) bool; False where it was not
            recorded.
        images: RGB by camera, (H, W, 3) uint8 each; empty unless rendered.
        depths: Distance along the optical axis by camera, tenths of a millimetre, (H, W) uint16 each; empty
            unless rendered.
        points: (P, 3) float32, metres, world frame; None unless rendered.
        point_colors: (P, 3) uint8; None unless rendered.
        episode: The recording.
    """

    fps: int
    robot: Mapping[str, Floats]
    objects: Mapping[str, Floats]
    privileged: bool
    actions: Floats
    layout: ActionLayout
    rewards: Floats
    phase: NDArray[np.int64]
    gate: NDArray[np.bool_]
    contact: NDArray[np.bool_]
    images: Mapping[str, NDArray[np.uint8]]
    depths: Mapping[str, NDArray[np.uint16]]
    points: Floats | None
    point_colors: NDArray[np.uint8] | None
    episode: Episode

    __repr__ = one_line

    def __len__(self) -> int:
        return len(self.actions)

    @property
    def id(self) -> str:
        """Id of the episode."""
        return self.episode.id

    @property
    def success(self) -> bool:
        """Whether the episode succeeded."""
        return self.episode.success

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the components of an action."""
        return self.layout.names

    @property
    def state(self) -> Floats:
        """What the robot measures of itself: end-effector pose, width, joint positions; shape (T, 15)."""
        return np.concatenate([self.robot[name] for name in STATE], axis=1)

    @property
    def object_state(self) -> Floats:
        """Poses and twists of all objects and fixtures side by side, shape (T, 13 n)."""
        return np.concatenate(list(self.objects.values()), axis=1)

    @property
    def object_names(self) -> list[str]:
        """Names of the components of `object_state`, e.g. "can_position_x"."""
        return [f"{key}_{axis}" for key in self.objects for axis in axes_of(key)]

    @property
    def low_dimensional(self) -> dict[str, NDArray[Any]]:
        """What dp3-zarr and the pack contain besides what was rendered, by name."""
        return {
            "state": self.state,
            "action": self.actions,
            "dq": self.robot["dq"],
            "phase": self.phase,
            "gate": self.gate,
            "contact": self.contact,
        }


def env_of(task: Task) -> str:
    """Return the id of the env that a task's exported actions belong to, e.g. "DynaForge/CanTask-v0"."""
    return f"DynaForge/{task.env_name}Task-v0"


def env_arguments_of(task: Task, layout: ActionLayout) -> dict[str, Any]:
    """Return the arguments with which the env takes such actions in the setting of a task, as plain JSON data."""
    return layout.env_arguments | task.setting.to_dict()


def axes_of(key: str) -> tuple[str, ...]:
    """Return the names of the components of a quantity in `Frames.objects`."""
    return ("w", *AXES) if key.endswith("_quat_wxyz") else AXES


def read_frames(
    dataset: DemonstrationDataset,
    *,
    fps: int,
    actions: ActionMode = "ee",
    rotation: RotationForm = "quat_wxyz",
    elbow: bool = True,
    observations: ObservationFolder | None = None,
    depth: bool = True,
    privileged: bool | None = None,
    failures: bool = False,
) -> Iterator[Frames]:
    """Iterate over the episodes of a dataset, in the order of their ids.

    Args:
        dataset: The dataset.
        fps: Control steps per second of the recordings.
        actions: "ee" or "joint".
        rotation: Form of the rotation in an "ee" action: "quat_wxyz" (w, x, y, z), "rotation_6d" or "rotvec" (see
            `ActionLayout`).
        elbow: Whether an "ee" action ends with the third joint's angle, without which fast motions are not reproduced
            exactly.
        observations: Rendered pictures and points to include.
        depth: Whether to include depth maps.
        privileged: Whether an export is to contain the true state of the objects; by default only where no
            observations show them.
        failures: Whether to include failed episodes.

    Raises:
        ValueError: Actions or rotation are unknown, fps is no whole number above 0 or not that of the recording, or
            observations were rendered from another recording.
        FileNotFoundError: An episode was not rendered.
    """
    _one_of(ACTION_MODES, actions, "Actions")
    _one_of(tuple(ROTATIONS), rotation, "Rotations")
    if actions == "joint" and rotation != "quat_wxyz":
        raise ValueError(f"Joint positions have no rotation; leave {rotation!r} out, or take actions 'ee'.")
    if not isinstance(fps, numbers.Integral) or isinstance(fps, bool) or fps < 1:
        raise ValueError(f"fps is a whole number of control steps a second, at least 1, e.g. 30; given {fps!r}.")
    layout = ActionLayout(actions, rotation, elbow and actions == "ee")
    selection = _Selection(int(fps), layout, depth, privileged if privileged is not None else observations is None)
    return _read(dataset, observations, failures, selection)


@dataclass(frozen=True, slots=True)
class _Selection:
    """Which parts of an episode are read, in the terms of `read_frames`."""

    fps: int
    layout: ActionLayout
    depth: bool
    privileged: bool


def _read(
    dataset: DemonstrationDataset, observations: ObservationFolder | None, failures: bool, selection: _Selection
) -> Iterator[Frames]:
    for episode in dataset:
        if len(episode) and (episode.success or failures):
            _check_rate(episode, selection.fps)
            yield _frames(episode, observations, selection)  # without a local name, which would keep the pictures alive


def _one_of(known: tuple[str, ...], given: str, plural: str) -> None:
    if given not in known:
        close = difflib.get_close_matches(str(given), known, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise ValueError(f"{plural} are one of {', '.join(known)}, not {given!r}.{hint}")


def _check_rate(episode: Episode, fps: int) -> None:
    """Check that the given rate is that of the recording, which contains its times."""
    times = episode.steps["time"]
    if len(times) > 1 and fps != (recorded := round(1.0 / float(np.median(np.diff(times))))):
        raise ValueError(f"Episode {episode.id} was recorded at {recorded} control steps a second, not {fps}.")


def _frames(episode: Episode, observations: ObservationFolder | None, selection: _Selection) -> Frames:
    steps, n = episode.steps, len(episode)
    rendered = _rendered(observations, episode)
    return Frames(
        fps=selection.fps,
        robot=robot_columns(steps),
        objects=object_columns(steps),
        privileged=selection.privileged,
        actions=selection.layout.of_steps(steps).astype(np.float32),
        layout=selection.layout,
        rewards=steps["reward"].astype(np.float32),
        phase=steps.get("phase", np.full(n, -1)).astype(np.int64),
        gate=steps.get("gate", np.zeros(n, dtype=bool)),
        contact=contact_columns(steps),
        images=rendered["rgb"],
        depths=rendered["depth"] if selection.depth else {},
        points=rendered["points"],
        point_colors=rendered["point_colors"],
        episode=episode,
    )


def robot_columns(steps: Mapping[str, Any]) -> dict[str, Floats]:
    """Return the state of the robot as exports contain it, from recorded columns named as in `demos.schema`."""
    columns = {name: np.asarray(steps[name]) for name in ROBOT_NAMES}
    columns["ee_quat_wxyz"] = without_jumps(columns["ee_quat_wxyz"])
    columns["width"] = columns["width"][:, None]
    return {name: column.astype(np.float32) for name, column in columns.items()}


def object_columns(steps: Mapping[str, Any]) -> dict[str, Floats]:
    """Return the states of objects and fixtures as exports contain them, from recorded columns likewise."""
    objects = {}
    for key, values in sorted(steps.items()):  # the order of `object_state`
        kind, _, rest = key.partition("/")
        if kind in ("object", "fixture"):
            name, column = rest.replace("/", "_"), np.asarray(values)
            smooth = without_jumps(column) if name.endswith("_quat_wxyz") else column
            objects[name] = smooth.astype(np.float32)
    return objects


def contact_columns(steps: Mapping[str, Any]) -> NDArray[np.bool_]:
    """Return whether each finger touches the manipulated object, shape (T, 2), from recorded columns likewise."""
    no_contact = np.zeros(len(steps["time"]), dtype=bool)
    return np.column_stack([steps.get(f"{side}_contact", no_contact) for side in CONTACTS])


def _rendered(observations: ObservationFolder | None, episode: Episode) -> dict[str, Any]:
    """Return what was rendered of an episode: pictures and depth maps by camera, points and their colours."""
    if observations is None:
        return {"rgb": {}, "depth": {}, "points": None, "point_colors": None}
    settings, arrays = observations.settings, observations.of(episode)
    cameras = [camera.name for camera in settings.cameras] if settings.images else []
    return {
        "rgb": {name: arrays[f"{name}/rgb"] for name in cameras},
        "depth": {name: arrays[f"{name}/depth"] for name in cameras},
        "points": arrays["points"].astype(np.float32) if settings.points else None,
        "point_colors": arrays["point_colors"] if settings.points else None,
    }
