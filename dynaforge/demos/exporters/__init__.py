"""Demonstrations in the formats that other libraries read."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable
from functools import partial
from importlib import import_module
from pathlib import Path

from dynaforge.demos.exporters.frames import Frames, read_frames
from dynaforge.tasks import Task

__all__ = ["FORMATS", "Frames", "exporter", "read_frames"]

FORMATS = {
    "lerobot": "LeRobotDataset v3.0: parquet and, with rendered images, MP4",
    "robomimic": "robomimic HDF5, low-dimensional and images",
    "dp3-zarr": "3D Diffusion Policy's zarr; needs rendered points",
    "minari": "Minari (HDF5), low-dimensional",
}
UNFINISHED = ".unfinished"
Exporter = Callable[[Path, Task, Iterable[Frames]], int]


def exporter(name: str) -> Exporter:
    """Return the function that writes a format: it takes a folder, a task and episodes, and returns how many it wrote.

    It reads the episodes one by one and keeps none. The folder must be new or empty; an export that ends early leaves
    it as it was.

    Raises:
        ValueError: There is no such format.
        ImportError: A library of the `[data]` extra is missing.
    """
    if name not in FORMATS:
        raise ValueError(f"No format {name!r}; there are {', '.join(FORMATS)}.")
    try:
        module = import_module(f"dynaforge.demos.exporters.{name.replace('-', '_')}")
    except ImportError as error:
        raise ImportError(f"Format {name} needs {error.name}: pip install 'dynaforge[data]'.") from error
    return partial(_write_atomically, module.write)


def _write_atomically(write: Exporter, folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write into a hidden folder beside the final files, and move them once all are complete."""
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    if existing := sorted(path.name for path in folder.iterdir() if not path.name.startswith(".")):
        raise FileExistsError(f"{folder} holds {', '.join(existing[:3])} already. Choose a new or empty folder.")
    unfinished = folder / UNFINISHED
    shutil.rmtree(unfinished, ignore_errors=True)  # of an export that was killed
    unfinished.mkdir()
    try:
        n = write(unfinished, task, episodes)
        for path in unfinished.iterdir():
            os.replace(path, folder / path.name)
    except BaseException:
        shutil.rmtree(folder if new else unfinished, ignore_errors=True)
        raise
    unfinished.rmdir()
    return n
