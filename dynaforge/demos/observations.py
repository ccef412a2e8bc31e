"""What cameras would have seen during an episode, rendered afterwards: colour, depth, segmentation, point clouds."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.episode import Episode
from dynaforge.demos.episode_file import SUFFIX
from dynaforge.demos.observation_file import REMEDY, SETTINGS, Layout, read_observations, write_observations
from dynaforge.demos.untrusted import (
    MALFORMED_FILE_ERRORS,
    NOTES,
    DamagedFileError,
    kind_of,
    parse_json,
    printable,
    read_file,
)
from dynaforge.files.atomic import atomic_write
from dynaforge.geometry import Array
from dynaforge.sim.camera import Camera, Image, world_points
from dynaforge.tasks import Task

if TYPE_CHECKING:  # reading observations alone must not import physics
    from dynaforge.sim import SimScene

WORKSPACE = ((0.0, -0.65, 0.002), (0.95, 0.65, 0.75))  # metres: all that the tasks reach, above the table
FOLDER = "observations"
_CAMERA_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
WRIST = Camera("wrist", (0.08, 0.0, -0.12), (0.0, 0.0, 0.03), up=(1.0, 0.0, 0.0), in_hand=True, fov=70.0)


def standard_cameras(task: Task) -> dict[str, Camera]:
    """Return the cameras of every task, by name: the one that films its clips, its mirror, and one at the hand."""
    eye, look_at = task.camera
    return {
        "front": Camera("front", eye, look_at),
        "side": Camera("side", (eye[0], -eye[1], eye[2]), look_at),
        "wrist": WRIST,
    }


@dataclass(frozen=True, slots=True)
class ObservationSettings:
    """What is rendered at each control step.

    Attributes:
        cameras: The cameras.
        images: Whether to keep colour, depth and segmentation of each camera.
        points: Size of the point cloud of all cameras together; 0 for none.
        workspace: Corners of the box that the points are cropped to, metres, world frame.
    """

    cameras: tuple[Camera, ...]
    images: bool = True
    points: int = 0
    workspace: tuple[tuple[float, float, float], tuple[float, float, float]] = WORKSPACE

    def __post_init__(self) -> None:
        names = [camera.name for camera in self.cameras]
        for name in names:  # it becomes part of names of files and arrays, and settings may come from anybody
            if not isinstance(name, str) or not _CAMERA_NAME.fullmatch(name) or name in ("points", "point_colors"):
                raise ValueError(f"{name!r} is no name for a camera; take letters and digits, with . _ - between.")
        if not names or len(set(names)) < len(names):
            raise ValueError(f"Observations need at least one camera, and names that differ; given {names}.")
        if self.points < 0 or not (self.images or self.points):
            raise ValueError("Nothing to render: keep the images, or ask for at least one point.")

    @property
    def layout(self) -> Layout:
        """Shape at one control step and type of each array."""
        found: dict[str, tuple[tuple[int, ...], str]] = {}
        for camera in self.cameras:
            width, height = camera.size
            if self.images:
                found |= {
                    f"{camera.name}/rgb": ((height, width, 3), "uint8"),
                    f"{camera.name}/depth": ((height, width), "uint16"),
                    f"{camera.name}/segmentation": ((height, width), "int8"),
                }
            found |= {f"{camera.name}/position": ((3,), "float64"), f"{camera.name}/quat_wxyz": ((4,), "float64")}
        if self.points:
            found |= {"points": ((self.points, 3), "float16"), "point_colors": ((self.points, 3), "uint8")}
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON data, including the intrinsics, for readers that do not use a field of view."""
        cameras = [camera.to_dict() | {"intrinsics": camera.intrinsics.tolist()} for camera in self.cameras]
        return {"cameras": cameras, "images": self.images, "points": self.points, "workspace": self.workspace}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> ObservationSettings:
        """Read what `to_dict` wrote.

        Raises:
            ValueError: The data does not describe settings.
        """
        try:
            cameras = tuple(
                Camera.from_dict({k: v for k, v in camera.items() if k != "intrinsics"}) for camera in data["cameras"]
            )
            low, high = (tuple(corner) for corner in data["workspace"])
            return ObservationSettings(cameras, data["images"], data["points"], (low, high))
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"No settings of observations: {error}.") from error


class ObservationRenderer:
    """Simulates episodes of one task again and renders them on the way.

    Args:
        task: The task.
        settings: What to render.
    """

    def __init__(self, task: Task, settings: ObservationSettings) -> None:
        self._views = CameraViews(settings)
        from dynaforge.demos.replay import Replayer  # here, since reading observations alone must not import physics

        self._replayer = Replayer(task, visuals="plain")

    def render(self, episode: Episode) -> dict[str, NDArray[Any]]:
        """Return the arrays of an episode, leading dimension T: the view at the beginning of each control step.

        `<camera>/rgb` (T, H, W, 3) uint8, `<camera>/depth` (T, H, W) uint16 in tenths of a millimetre,
        `<camera>/segmentation` (T, H, W) int8, `<camera>/position` (T, 3) and `<camera>/quat_wxyz` (T, 4) of the
        optical frame in the world; `points` (T, P, 3) float16, metres, world frame, and `point_colors` (T, P, 3) uint8,
        both zero at a step where no camera sees a point of the workspace.

        Raises:
            ImportError: Points are asked for and `fpsample`, of the `[data]` extra, is missing.
            ValueError: The episode cannot be simulated again, its replay leaves the recording, or no camera ever sees
                a point of the workspace.
        """
        columns: dict[str, list[Any]] = {}
        for _ in self._replayer.recorded_states(episode):
            for name, value in self._views.of(self._replayer.scene):
                columns.setdefault(name, []).append(value)
        if "points" in columns and not np.any(columns["points"]):
            raise ValueError("No camera ever sees a point in the workspace; move a camera or widen the workspace.")
        return {name: np.stack(column) for name, column in columns.items()}

    def names(self) -> list[str]:
        """Return what the numbers in a segmentation stand for, in order."""
        return list(self._replayer.scene.names)

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._replayer.close()


class CameraViews:
    """What cameras see of a scene in its present state; the scene must have been loaded with visuals="plain".

    Args:
        settings: What to render.
    """

    def __init__(self, settings: ObservationSettings) -> None:
        self._settings = settings
        self._low, self._high = (np.array(corner) for corner in settings.workspace)

    def of(self, scene: SimScene) -> Iterator[tuple[str, Any]]:
        """Yield name and array of each quantity, as `ObservationRenderer.render` stacks them.

        Args:
            scene: The scene.
        """
        images = [scene.image(camera) for camera in self._settings.cameras]
        for camera, image in zip(self._settings.cameras, images, strict=True):
            if self._settings.images:
                yield f"{camera.name}/rgb", image.rgb
                yield f"{camera.name}/depth", np.round(image.depth * 1e4).clip(0, 65535).astype(np.uint16)
                yield f"{camera.name}/segmentation", image.segmentation
            yield f"{camera.name}/position", image.pose.position
            yield f"{camera.name}/quat_wxyz", image.pose.quat_wxyz
        if self._settings.points:
            points, colors = self._cropped(images)
            if not len(points):
                points, colors = np.zeros((1, 3)), np.zeros((1, 3), np.uint8)
            kept = farthest_points(points, self._settings.points)
            yield "points", points[kept].astype(np.float16)
            yield "point_colors", colors[kept]

    def _cropped(self, images: list[Image]) -> tuple[Array, NDArray[np.uint8]]:
        clouds, colors = [], []
        for camera, image in zip(self._settings.cameras, images, strict=True):
            points, visible = world_points(camera, image)
            inside = visible & (points > self._low).all(axis=-1) & (points < self._high).all(axis=-1)
            clouds.append(points[inside])
            colors.append(image.rgb[inside])
        return np.concatenate(clouds), np.concatenate(colors)


def farthest_points(points: Array, n: int) -> NDArray[np.int64]:
    """Choose n points that lie far apart, by farthest-point sampling from the first; fewer points are repeated.

    Args:
        points: Shape (M, 3).
        n: How many to choose.

    Returns:
        Indices of the chosen points, shape (n,).

    Raises:
        ImportError: `fpsample` is missing.
        ValueError: There is no point to choose.
    """
    try:
        import fpsample
    except ImportError as error:
        raise ImportError("Point clouds need fpsample: pip install 'dynaforge[data]'.") from error
    if not len(points):
        raise ValueError("There is no point to choose from.")
    if len(points) <= n:
        return np.resize(np.arange(len(points)), n)
    height = min(5, len(points).bit_length() - 1)  # of its tree, which must not have more leaves than there are points
    chosen = fpsample.bucket_fps_kdline_sampling(points.astype(np.float32), n, h=height, start_idx=0)
    return np.asarray(chosen, dtype=np.int64)


class ObservationFolder:
    """Rendered observations beside a dataset's episodes: `settings.json` and one file per episode.

    Args:
        path: The folder; by default `observations/` of the dataset.
        settings: What it is to contain; it is created if need be. None opens an existing folder, for reading.

    Attributes:
        settings: What it contains.
        digest: Digest of the settings file, which every file of observations names.

    Raises:
        FileNotFoundError: No settings were given and the folder contains none.
        DamagedFileError: It is no folder, or its settings cannot be read.
        ValueError: The folder contains observations with other settings.
    """

    def __init__(self, path: str | Path, settings: ObservationSettings | None = None) -> None:
        self.path = Path(path)
        if (kind := kind_of(self.path)) not in ("", "a folder"):
            raise DamagedFileError(self.path, f"it is {kind}, not a folder", remedy=REMEDY)
        marker = self.path / SETTINGS
        if not kind_of(marker):
            if settings is None:
                raise FileNotFoundError(f"{path} holds no observations; `dynaforge render` makes them.")
            self.path.mkdir(parents=True, exist_ok=True)
            atomic_write(marker, json.dumps(settings.to_dict(), indent=1).encode() + b"\n")
        text = read_file(marker, at_most=NOTES, remedy=f"{REMEDY} everything")
        self.settings = _settings(marker, text)
        if settings is not None and settings != self.settings:
            raise ValueError(f"{path} holds observations with other settings. Choose another --out, or remove it.")
        self.digest = hashlib.sha256(text).hexdigest()[:16]

    def file_of(self, episode_id: str) -> Path:
        """Return where the observations of an episode are, or would be, stored."""
        return self.path / f"{episode_id}{SUFFIX}"

    def missing(self, episode_ids: list[str]) -> list[str]:
        """Return the ids of the episodes that are not rendered yet."""
        return [name for name in episode_ids if not self.file_of(name).is_file()]

    def write(self, episode: Episode, arrays: Mapping[str, NDArray[Any]], names: list[str]) -> None:
        """Write the observations of an episode.

        Args:
            episode: The recording that was rendered.
            arrays: What `ObservationRenderer.render` returned, with the settings of this folder.
            names: What the numbers in the segmentations stand for.
        """
        write_observations(self.file_of(episode.id), episode, arrays, names=names, settings=self.digest)

    def __getitem__(self, episode_id: str) -> dict[str, NDArray[Any]]:
        """Read the observations of an episode, as `read_observations`."""
        return read_observations(self.file_of(episode_id), settings=self.digest, layout=self.settings.layout)

    def of(self, episode: Episode) -> dict[str, NDArray[Any]]:
        """Read the observations of a recording, and of no other with the same id.

        Raises:
            FileNotFoundError, DamagedFileError: As `read_observations`.
        """
        layout = self.settings.layout if len(episode) else None  # an episode without steps has no arrays
        return read_observations(self.file_of(episode.id), of=episode, settings=self.digest, layout=layout)


def _settings(path: Path, text: bytes) -> ObservationSettings:
    try:
        return ObservationSettings.from_dict(parse_json(text))
    except MALFORMED_FILE_ERRORS as error:
        raise DamagedFileError(
            path, f"it holds no settings ({printable(error)})", remedy=f"{REMEDY} everything"
        ) from error
