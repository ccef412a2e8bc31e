"""The zarr (format 2) that 3D Diffusion Policy reads: point_cloud, state, action, episode_ends."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numcodecs
import numpy as np
import zarr
from numpy.typing import NDArray

from dynaforge.demos.exporters.frames import Frames
from dynaforge.tasks import Task

FOLDER = "demos.zarr"
ROWS = 100  # control steps a chunk


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write `demos.zarr`; returns the number of demonstrations.

    Raises:
        ValueError: There is none, or its points were not rendered.
    """
    final, temporary = folder / FOLDER, folder / f".{FOLDER}.tmp"
    shutil.rmtree(temporary, ignore_errors=True)
    root = zarr.open_group(str(temporary), mode="w", zarr_format=2)
    data, ends = root.create_group("data"), [0]
    for episode in episodes:
        if episode.points is None or episode.point_colors is None:
            raise ValueError("Format dp3-zarr needs point clouds: dynaforge render FOLDER --points 1024.")
        rows: dict[str, NDArray[Any]] = {
            "point_cloud": episode.points, "point_cloud_color": episode.point_colors,
            "state": episode.state, "action": episode.actions,
        }  # fmt: skip
        for name, row in rows.items():
            if name not in data:
                data.create_array(
                    name, shape=(0, *row.shape[1:]), chunks=(ROWS, *row.shape[1:]), dtype=row.dtype,
                    compressors=numcodecs.Blosc(cname="zstd", clevel=3, shuffle=numcodecs.Blosc.SHUFFLE),
                )  # fmt: skip
            data[name].append(row)
        ends.append(ends[-1] + len(episode))
    if len(ends) == 1:
        raise ValueError("There is no demonstration to export.")
    root.create_group("meta").create_array("episode_ends", data=np.array(ends[1:], dtype=np.int64))
    os.replace(temporary, final)
    return len(ends) - 1
