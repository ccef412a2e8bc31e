"""Rendering of the observations of a dataset from its recordings, in worker processes or on a Ray cluster."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.episode import Episode
from dynaforge.demos.observation_file import observation_bytes
from dynaforge.demos.observations import ObservationFolder, ObservationRenderer, ObservationSettings
from dynaforge.files.atomic import atomic_write
from dynaforge.sampling.jobs import in_order
from dynaforge.sampling.processes import usable_cores, worker_pool
from dynaforge.sampling.ray_cluster import cluster_cores
from dynaforge.sampling.ray_jobs import RayJobs
from dynaforge.sim.camera import Camera
from dynaforge.tasks import Task

EPISODES_PER_CHUNK = 8  # episodes that a worker is given at a time


def render_episodes(
    dataset: Path, folder: ObservationFolder, task: Task, ids: Sequence[str], *, workers: int | None = None
) -> Iterator[tuple[str, str]]:
    """Render episodes into a folder of observations.

    Args:
        dataset: Folder of the recordings.
        folder: Where the observations are written; its settings say what is rendered.
        task: The dataset's task.
        ids: Ids of the episodes.
        workers: Number of processes; by default one per core that this process may use.

    Yields:
        The id of each episode once it is done, and why it could not be rendered; "" if it was.

    Raises:
        OSError: An observation cannot be written.
    """
    if not ids:
        return
    with worker_pool(workers or usable_cores(), _start, dataset, folder.path, task) as pool:
        yield from zip(ids, pool.map(_render, ids, chunksize=EPISODES_PER_CHUNK), strict=True)


def render_episodes_on_ray(
    dataset: Path, folder: ObservationFolder, task: Task, ids: Sequence[str], *, workers: int | None = None
) -> Iterator[tuple[str, str]]:
    """Render episodes on a running Ray cluster, into the same files as `render_episodes`.

    This process reads the recordings and writes the observations, so that no folder need be shared.

    Args:
        dataset: Folder of the recordings.
        folder: Where the observations are written; its settings say what is rendered.
        task: The dataset's task; dynaforge must be installed on every node.
        ids: Ids of the episodes.
        workers: Number of actors, one core each; by default one per core of the cluster.

    Yields:
        The id of each episode once it is done, and why it could not be rendered; "" if it was.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
        NoWorkers: No actor becomes ready.
        OSError: An observation cannot be written.
    """
    if not ids:
        return
    recordings = DemonstrationDataset(dataset)
    make = partial(_Rendering, task, folder.settings, folder.digest)
    actors = RayJobs(make, failed=lambda _, problem: problem, size=min(workers or cluster_cores(), len(ids)))
    with closing(in_order(actors, (_read(recordings, name) for name in ids))) as rendered:
        for name, content in zip(ids, rendered, strict=True):
            yield name, _store(content, folder.file_of(name))


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


class _Rendering:
    """Renders recordings to the bytes of their observation files."""

    def __init__(self, task: Task, settings: ObservationSettings, digest: str) -> None:
        self._renderer, self._digest = ObservationRenderer(task, settings), digest

    def __call__(self, recording: Episode | str) -> bytes | str:
        """Return the bytes, or why there are none."""
        if isinstance(recording, str):
            return recording
        try:
            arrays = self._renderer.render(recording)
        except (ValueError, OSError) as error:
            return str(error)
        return observation_bytes(recording, arrays, names=self._renderer.names(), settings=self._digest)


def _read(dataset: DemonstrationDataset, name: str) -> Episode | str:
    """Return a recording, or why it cannot be read."""
    try:
        return dataset[name]
    except (ValueError, OSError) as error:
        return str(error)


def _store(content: bytes | str, path: Path) -> str:
    """Write observations, if there are any; else return why there are none."""
    if isinstance(content, str):
        return content
    atomic_write(path, content)  # where it fails, a full disk say, the rendering must end
    return ""


# The state of a worker process:
_rendering: _Rendering | None = None
_dataset: DemonstrationDataset | None = None
_folder: ObservationFolder | None = None


def _start(dataset: Path, observations: Path, task: Task) -> None:
    global _rendering, _dataset, _folder
    _dataset, _folder = DemonstrationDataset(dataset), ObservationFolder(observations)
    _rendering = _Rendering(task, _folder.settings, _folder.digest)


def _render(name: str) -> str:
    assert _rendering is not None
    assert _dataset is not None
    assert _folder is not None
    return _store(_rendering(_read(_dataset, name)), _folder.file_of(name))
