"""Rendering the observations of a dataset on all cores, from its recordings."""

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

EPISODES_PER_CHUNK = 8  # handed to a worker at a time


def render_episodes(
    dataset: Path, folder: ObservationFolder, task: Task, ids: Sequence[str], *, workers: int
) -> Iterator[tuple[str, str]]:
    """Render episodes into a folder of observations.

    Args:
        dataset: Folder of the recordings.
        folder: Where the observations go; its settings say what is rendered.
        task: The dataset's task.
        ids: The episodes.
        workers: Processes.

    Yields:
        The id of each episode when it is done, and why it could not be rendered; "" if it was.

    Raises:
        OSError: An observation cannot be written.
    """
    if not ids:
        return
    with worker_pool(workers, _start, dataset, folder.path, task) as pool:
        yield from zip(ids, pool.map(_render, ids, chunksize=EPISODES_PER_CHUNK), strict=True)


def require_point_sampling() -> None:
    """Check for the package that samples point clouds, without importing it.

    Raises:
        ImportError: It is not installed.
    """
    if find_spec("fpsample") is None:
        raise ImportError("Point clouds need fpsample: pip install 'dynaforge[data]'.")


def read_cameras(path: Path) -> dict[str, Camera]:
    """Return the cameras of a JSON file, by name.

    Raises:
        ValueError: The file lists none, or what is wrong with one.
    """
    listed = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(listed, list) or not listed:
        raise ValueError('it must be a list, such as [{"name": "top", "eye": [0.5, 0, 1], "look_at": [0.5, 0.1, 0]}]')
    cameras = {camera.name: camera for camera in map(Camera.from_dict, listed)}
    if len(cameras) < len(listed):
        raise ValueError("two cameras have one name")
    return cameras


_renderer: ObservationRenderer | None = None  # these three of a worker process
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
    _folder.write(episode, arrays, _renderer.names())  # outside the try: a full disk ends the whole rendering
    return ""
