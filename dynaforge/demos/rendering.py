"""Rendering of the observations of a dataset from its recordings, in worker processes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.observations import ObservationFolder, ObservationRenderer
from dynaforge.sampling.processes import worker_pool
from dynaforge.sim.camera import Camera
from dynaforge.tasks import Task

EPISODES_PER_CHUNK = 8  # episodes that a worker is given at a time


def render_episodes(
    dataset: Path, folder: ObservationFolder, task: Task, ids: Sequence[str], *, workers: int
) -> Iterator[tuple[str, str]]:
    """Render episodes into a folder of observations.

    Args:
        dataset: Folder of the recordings.
        folder: Where the observations are written; its settings say what is rendered.
        task: The dataset's task.
        ids: Ids of the episodes.
        workers: Number of processes.

    Yields:
        The id of each episode once it is done, and why it could not be rendered; "" if it was.

    Raises:
        OSError: An observation cannot be written.
    """
    if not ids:
        return
    with worker_pool(workers, _start, dataset, folder.path, task) as pool:
        yield from zip(ids, pool.map(_render, ids, chunksize=EPISODES_PER_CHUNK), strict=True)


def require_point_sampling() -> None:
    """Check that the package that samples point clouds is installed, without importing it.

    Raises:
        ImportError: It is not installed.
    """
    if find_spec("fpsample") is None:
        raise ImportError("Point clouds need fpsample: pip install 'dynaforge[data]'.")


def read_cameras(path: Path) -> dict[str, Camera]:
    """Return the cameras that a JSON file lists, by name.

    Raises:
        ValueError: The file lists no camera, or one of them is malformed.
    """
    listed = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(listed, list) or not listed:
        raise ValueError('it must be a list, such as [{"name": "top", "eye": [0.5, 0, 1], "look_at": [0.5, 0.1, 0]}]')
    cameras = {camera.name: camera for camera in map(Camera.from_dict, listed)}
    if len(cameras) < len(listed):
        raise ValueError("two cameras have one name")
    return cameras


# The state of a worker process:
_renderer: ObservationRenderer | None = None
_dataset: DemonstrationDataset | None = None
_folder: ObservationFolder | None = None


def _start(dataset: Path, observations: Path, task: Task) -> None:
    global _renderer, _dataset, _folder
    _dataset, _folder = DemonstrationDataset(dataset), ObservationFolder(observations)
    _renderer = ObservationRenderer(task, _folder.settings)


def _render(name: str) -> str:
    assert _renderer is not None
    assert _dataset is not None
    assert _folder is not None
    try:
        episode = _dataset[name]
        arrays = _renderer.render(episode)
    except (ValueError, OSError) as error:
        return str(error)
    _folder.write(episode, arrays, _renderer.names())  # outside the try, since a full disk must end the rendering
    return ""
