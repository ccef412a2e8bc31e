"""`dynaforge render`: pictures and point clouds of collected episodes, in a second pass; resumes."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.observations import (
    WORKSPACE,
    ObservationFolder,
    ObservationRenderer,
    ObservationSettings,
    standard_cameras,
)
from dynaforge.sampling.processes import worker_pool
from dynaforge.sim.camera import Camera
from dynaforge.tasks import Task

AT_A_TIME = 8  # episodes handed to a worker


def run(options: argparse.Namespace) -> int:
    """Render what is missing."""
    dataset, task = open_dataset(options)
    settings = _settings(options, task)
    if settings.points:
        _need_fpsample()
    folder = ObservationFolder(options.out, settings)
    names = dataset.ids()
    missing = folder.missing(names)
    print(f"{len(names)} episodes, {len(names) - len(missing)} rendered; stored in {folder.path}")
    failed = 0
    for name, problem in tqdm(_render(options, task, folder, missing), total=len(missing), unit="episode"):
        if problem:
            failed += 1
            tqdm.write(f"{dataset.file_of(name)}: {problem}")
    print(f"{len(missing) - failed} rendered" + (f", {failed} could not be" if failed else ""))
    return 1 if failed else 0


def _need_fpsample() -> None:
    from importlib.util import find_spec

    if find_spec("fpsample") is None:
        raise ImportError("Point clouds need fpsample: pip install 'dynaforge[data]'.")


def _settings(options: argparse.Namespace, task: Task) -> ObservationSettings:
    own = _cameras_of(options.camera_file) if options.camera_file else {}
    known = standard_cameras(task) | own
    if unknown := [name for name in options.cameras if name not in known]:
        raise ValueError(f"--cameras: No camera {', '.join(unknown)}; there are {', '.join(known)}.")
    if own and not set(own) & set(options.cameras):
        raise ValueError(f"--camera-file {options.camera_file}: --cameras names none of its {', '.join(own)}.")
    cameras = [known[name] for name in options.cameras]
    if options.size:
        cameras = [replace(camera, size=tuple(options.size)) for camera in cameras]
    corners = options.workspace
    workspace = (tuple(corners[:3]), tuple(corners[3:])) if corners else WORKSPACE
    return ObservationSettings(tuple(cameras), not options.no_images, options.points, workspace)


def _cameras_of(path: Path) -> dict[str, Camera]:
    """Read a user's cameras, by name.

    Raises:
        ValueError: The file lists none, or what is wrong with one.
    """
    try:
        listed = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(listed, list) or not listed:
            raise ValueError(
                'it must be a list, such as [{"name": "top", "eye": [0.5, 0, 1], "look_at": [0.5, 0.1, 0]}]'
            )
        cameras = [Camera.from_dict(entry) for entry in listed]
        if len({camera.name for camera in cameras}) < len(cameras):
            raise ValueError("two cameras have one name")
    except (ValueError, RecursionError) as error:
        raise ValueError(f"--camera-file {path}: {error}") from error
    return {camera.name: camera for camera in cameras}


_renderer: ObservationRenderer | None = None
_dataset: DemonstrationDataset | None = None
_folder: ObservationFolder | None = None


def _render(
    options: argparse.Namespace, task: Task, folder: ObservationFolder, names: list[str]
) -> Iterator[tuple[str, str]]:
    """Render episodes on all cores; yields (id, problem or "") as they are done."""
    if not names:
        return
    with worker_pool(options.workers, _start, options.folder, folder.path, task) as pool:
        yield from zip(names, pool.map(_render_one, names, chunksize=AT_A_TIME), strict=True)


def _start(data: Path, observations: Path, task: Task) -> None:
    global _renderer, _dataset, _folder
    _dataset, _folder = DemonstrationDataset(data), ObservationFolder(observations)
    _renderer = ObservationRenderer(task, _folder.settings)


def _render_one(name: str) -> str:
    assert _renderer is not None
    assert _dataset is not None
    assert _folder is not None
    try:
        episode = _dataset[name]
        arrays = _renderer.render(episode)
    except (ValueError, OSError) as error:
        return str(error)
    _folder.write(episode, arrays, _renderer.things())  # a full disk ends it all
    return ""
