"""One sealed HDF5 file with the observations of an episode: one array per quantity, each checked before it is read."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from dynaforge.demos.episode import Episode
from dynaforge.demos.episode_file import check_seal, sealed
from dynaforge.demos.untrusted import (
    MALFORMED_FILE_ERRORS,
    DamagedFileError,
    check_links,
    printable,
    read_array,
    read_file,
    read_text,
)
from dynaforge.files.atomic import atomic_write

SETTINGS = "settings.json"
REMEDY = "render"  # how a damaged file is made again
LONGEST = 2**32  # bytes of observations of an episode that are read at most, compressed or not
Layout = Mapping[str, tuple[tuple[int, ...], str]]
"""Shape at one control step and type of each array, by its name."""


def write_observations(
    path: Path, episode: Episode, arrays: Mapping[str, NDArray[Any]], *, names: list[str], settings: str = ""
) -> None:
    """Write the observations of an episode, whole or not at all.

    Args:
        path: The file.
        episode: The recording that was rendered.
        arrays: What `ObservationRenderer.render` returned.
        names: What the numbers in the segmentations stand for.
        settings: Digest of the settings file beside it.
    """
    atomic_write(path, observation_bytes(episode, arrays, names=names, settings=settings))


def observation_bytes(
    episode: Episode, arrays: Mapping[str, NDArray[Any]], *, names: list[str], settings: str = ""
) -> bytes:
    """Return what `write_observations` writes.

    Args:
        episode: The recording that was rendered.
        arrays: What `ObservationRenderer.render` returned.
        names: What the numbers in the segmentations stand for.
        settings: Digest of the settings file beside it.
    """
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver="latest") as file:
        file.attrs["episode"] = episode.id
        file.attrs["content_hash"] = episode.content_hash()
        file.attrs["settings"] = settings
        file.attrs["things"] = json.dumps(names)
        for name, array in arrays.items():
            image = array.ndim >= 4 or name.endswith(("depth", "segmentation"))
            compression = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if image else {}
            chunks = (1, *array.shape[1:]) if image else None
            file.create_dataset(name, data=array, chunks=chunks, **compression)
    return sealed(buffer.getvalue())


def read_observations(
    path: Path, *, of: Episode | None = None, settings: str | None = None, layout: Layout | None = None
) -> dict[str, NDArray[Any]]:
    """Read the observations of an episode after checking every byte.

    Args:
        path: The file.
        of: The episode that they must have been rendered from, bit for bit; None for any.
        settings: Digest of the settings file that they must have been rendered with; None for any.
        layout: The arrays that they must contain; None for any.

    Raises:
        FileNotFoundError: There are none.
        DamagedFileError: The file was altered or truncated, contains something else, or was rendered from another
            recording or with other settings.
    """
    data = read_file(path, at_most=LONGEST, remedy=REMEDY)
    check_seal(path, data, remedy=REMEDY)
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            check_links(file)
            recording, rendered_with = read_text(file, "content_hash"), read_text(file, "settings")
            if of is not None and of.content_hash() != recording:
                raise DamagedFileError(path, "it was rendered from another recording", remedy=REMEDY)
            if settings is not None and settings != rendered_with:
                raise DamagedFileError(
                    path, f"it was rendered with other settings than {SETTINGS} holds", remedy=REMEDY
                )
            return _read_arrays(file, layout, len(of) if of is not None else None)
    except DamagedFileError:
        raise
    except MALFORMED_FILE_ERRORS as error:
        raise DamagedFileError(path, f"its content cannot be read ({printable(error)})", remedy=REMEDY) from error


def _read_arrays(file: Any, layout: Layout | None, length: int | None) -> dict[str, NDArray[Any]]:
    """Read every array of an open file, after checking what it claims to be.

    Raises:
        ValueError: An array is missing, unexpected, too large, or of another shape or type.
    """
    found: dict[str, Any] = {}
    file.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    if layout is not None:
        _check_layout(found, layout, length)
    if sum(data.nbytes for data in found.values()) > LONGEST:
        raise ValueError(f"it claims more than {LONGEST / 1e9:.0f} GB")
    return {name: read_array(file, name, at_most=LONGEST) for name in found}


def _check_layout(found: Mapping[str, Any], layout: Layout, length: int | None) -> None:
    """Compare the arrays with the expected ones; where no length is given, all must be as long as the first."""
    if odd := sorted(set(found) ^ set(layout)):
        raise ValueError(f"{printable(odd[0])} is {'missing' if odd[0] in layout else 'none of its arrays'}")
    for name, (shape, kind) in layout.items():
        data = found[name]
        length = len(data) if length is None and data.shape else length
        if data.shape != (length, *shape) or data.dtype != kind:
            raise ValueError(f"{name} is {data.shape} {data.dtype}, where {(length, *shape)} {kind} is expected")
