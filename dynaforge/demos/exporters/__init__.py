"""Demonstrations in the formats that other libraries read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path

from dynaforge.demos.exporters.frames import Frames, read_frames
from dynaforge.tasks import Task

__all__ = ["FORMATS", "Frames", "exporter", "read_frames"]

FORMATS = {
    "lerobot": "LeRobotDataset v3.0: parquet and, with rendered images, MP4",
    "robomimic": "robomimic HDF5, low-dimensional and images",
    "dp3-zarr": "3D Diffusion Policy's zarr; needs rendered points",
    "minari": "Minari (HDF5)",
}
Exporter = Callable[[Path, Task, Iterable[Frames]], int]


def exporter(name: str) -> Exporter:
    """Return what writes a format: called with folder, task and episodes, it returns how many it wrote.

    Raises:
        ValueError: No such format.
        ImportError: A library of the `[data]` extra is missing.
    """
    if name not in FORMATS:
        raise ValueError(f"No format {name!r}; there are {', '.join(FORMATS)}.")
    try:
        module = import_module(f"dynaforge.demos.exporters.{name.replace('-', '_')}")
    except ImportError as error:
        raise ImportError(f"Format {name} needs {error.name}: pip install 'dynaforge[data]'.") from error
    write: Exporter = module.write
    return write
