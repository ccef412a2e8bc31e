"""`dynaforge render`: pictures and point clouds of collected episodes, in a second pass; resumes."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.cli.engine import on_ray
from dynaforge.demos.observations import WORKSPACE, ObservationFolder, ObservationSettings, standard_cameras
from dynaforge.demos.rendering import (
    read_cameras,
    render_episodes,
    render_episodes_on_ray,
    require_point_sampling,
)
from dynaforge.sim.camera import Camera
from dynaforge.tasks import Task


def run(options: argparse.Namespace) -> int:
    """Render what is missing; return 1 where an episode could not be rendered."""
    render = render_episodes_on_ray if on_ray(options) else render_episodes
    dataset, task = open_dataset(options)
    settings = _settings(options, task)
    if settings.points:
        require_point_sampling()
    folder = ObservationFolder(options.out, settings)
    ids = dataset.ids()
    missing = folder.missing(ids)
    print(f"{len(ids)} episodes, {len(ids) - len(missing)} rendered; stored in {folder.path}")
    failed = 0
    rendering = render(options.folder, folder, task, missing, workers=options.workers)
    for name, problem in tqdm(rendering, total=len(missing), unit="episode"):
        if problem:
            failed += 1
            tqdm.write(f"{dataset.file_of(name)}: {problem}")
    print(f"{len(missing) - failed} rendered" + (f", {failed} could not be" if failed else ""))
    return 1 if failed else 0


def _settings(options: argparse.Namespace, task: Task) -> ObservationSettings:
    """Return the settings that the options mean.

    Raises:
        ValueError: A camera does not exist, or the cameras of the file are malformed or not used.
    """
    own = _own_cameras(options.camera_file) if options.camera_file else {}
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


def _own_cameras(path: Path) -> dict[str, Camera]:
    try:
        return read_cameras(path)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"--camera-file {path}: {error}") from error
