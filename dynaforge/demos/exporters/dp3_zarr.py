"""The zarr (format 2) that 3D Diffusion Policy reads: point_cloud, state, action, episode_ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numcodecs
import numpy as np
import zarr
from numpy.typing import NDArray

from dynaforge.demos.exporters.frames import CONTACTS, STATE_NAMES, Frames, env_arguments_of, env_of
from dynaforge.tasks import Task
from dynaforge.tasks.action import JOINTS

FOLDER = "demos.zarr"
CHUNK_ROWS = 100  # control steps in a chunk, unless that makes it larger than CHUNK_BYTES
CHUNK_BYTES = 2**21
NEEDED = "Format dp3-zarr needs point clouds: dynaforge render FOLDER --points 1024."


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write `demos.zarr` and return the number of demonstrations.

    Args:
        folder: Where to write.
        task: The task.
        episodes: What to write.

    Raises:
        ValueError: There is no demonstration, or its points were not rendered.
    """
    root = zarr.open_group(str(folder / FOLDER), mode="w", zarr_format=2)
    data, ends = root.create_group("data"), [0]
    for episode in episodes:
        for name, row in _arrays(episode):
            if name not in data:
                rows = max(1, min(CHUNK_ROWS, CHUNK_BYTES // row[0].nbytes))
                data.create_array(
                    name,
                    shape=(0, *row.shape[1:]),
                    chunks=(rows, *row.shape[1:]),
                    dtype=row.dtype,
                    compressors=numcodecs.Blosc(cname="zstd", clevel=3, shuffle=numcodecs.Blosc.SHUFFLE),
                )
            data[name].append(row)
        if len(ends) == 1:
            _describe(root, task, episode)
        ends.append(ends[-1] + len(episode))
        del episode, row  # free their memory before the next is read
    if len(ends) == 1:
        raise ValueError("There is no demonstration to export.")
    root.create_group("meta").create_array("episode_ends", data=np.array(ends[1:], dtype=np.int64))
    return len(ends) - 1


def _arrays(episode: Frames) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the arrays of an episode; those of the first camera have the names that DP3 gives to its only one."""
    if episode.points is None or episode.point_colors is None:
        raise ValueError(NEEDED)
    yield "point_cloud", episode.points
    yield "point_cloud_color", episode.point_colors
    yield from episode.low_dimensional.items()
    if episode.privileged:
        yield "privileged_state", episode.object_state
    for k, (camera, film) in enumerate(episode.images.items()):
        yield f"img_{camera}" if k else "img", film
    for k, (camera, depth) in enumerate(episode.depths.items()):
        yield f"depth_{camera}" if k else "depth", (depth * 1e-4).astype(np.float32)


def _describe(root: Any, task: Task, episode: Frames) -> None:
    names = {
        "state": STATE_NAMES,
        "action": episode.action_names,
        "dq": JOINTS,
        "contact": CONTACTS,
        "phase": [phase.name for phase in task.phases],
    }
    if episode.privileged:
        names["privileged_state"] = episode.object_names
    for name, components in names.items():
        root["data"][name].attrs["names"] = list(components)
    root.attrs["instruction"] = task.instruction
    root.attrs["env"] = {"id": env_of(task), **env_arguments_of(task, episode.layout)}
