"""Exports of any size: few episodes alive, few files open, nothing left of what does not end."""

from __future__ import annotations

import gc
import os
import tracemalloc
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynaforge.demos.exporters import FORMATS, Frames, exporter
from dynaforge.demos.exporters.statistics import Statistics, statistics
from dynaforge.demos.pack import Pack
from dynaforge.tasks import get_task

CAN = get_task("can")


def write(name: str, folder: Path, episodes: Iterator[Frames]) -> None:
    if name == "pack":
        Pack.write(folder, episodes)
    else:
        exporter(name)(folder, CAN, episodes)


def copies(
    episodes: list[Frames], n: int, *, born: list[weakref.ref[np.ndarray]] | None = None, scale: int = 1
) -> Iterator[Frames]:
    """Yield episodes whose pictures are their own, and larger."""
    for k in range(n):
        film = episodes[k % 3].images["front"].repeat(scale, axis=1).repeat(scale, axis=2)
        if born is not None:
            born.append(weakref.ref(film))
        frames = replace(episodes[k % 3], images={"front": film})
        del film
        yield frames
        del frames


@pytest.mark.parametrize("name", [*FORMATS, "pack"])
def test_no_pictures_live_on_once_they_are_written_and_no_file_stays_open(
    name: str, episodes: list[Frames], tmp_path: Path
) -> None:
    born: list[weakref.ref[np.ndarray]] = []
    alive, files = [], []

    def watched() -> Iterator[Frames]:
        for frames in copies(episodes, 4, born=born):
            alive.append(sum(film() is not None for film in born))
            files.append(len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0)
            yield frames
            del frames

    write(name, tmp_path / "out", watched())
    assert max(alive) == 1
    assert files[-1] == files[1]
    assert files[-1] - files[0] < 16


def test_memory_does_not_grow_with_the_number_of_pictures(episodes: list[Frames], tmp_path: Path) -> None:
    exporter("lerobot")(tmp_path / "first", CAN, copies(episodes, 1))  # what is imported counts for nothing
    peaks = []
    for n in (2, 6):
        gc.collect()
        tracemalloc.start()
        exporter("lerobot")(tmp_path / str(n), CAN, copies(episodes, n, scale=3))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    film = 9 * min(frames.images["front"].nbytes for frames in episodes)
    assert (peaks[1] - peaks[0]) / 4 < 0.5 * film


@pytest.mark.parametrize("reason", [RuntimeError, KeyboardInterrupt, MemoryError])
@pytest.mark.parametrize("name", [*FORMATS, "pack"])
def test_an_export_that_does_not_end_leaves_nothing(
    name: str, reason: type[BaseException], episodes: list[Frames], tmp_path: Path
) -> None:
    def breaking() -> Iterator[Frames]:
        yield episodes[0]
        raise reason

    before = dict(os.environ)
    with pytest.raises(reason):
        write(name, tmp_path / "out", breaking())
    assert not list(tmp_path.iterdir())
    assert dict(os.environ) == before


@pytest.mark.parametrize("name", FORMATS)
def test_what_a_folder_holds_is_never_mixed_with_an_export(name: str, episodes: list[Frames], tmp_path: Path) -> None:
    (tmp_path / "mine").touch()
    with pytest.raises(FileExistsError, match="holds mine already"):
        write(name, tmp_path, iter(episodes))
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_statistics_of_parts_are_those_of_the_whole() -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(5.0, 0.01, size=(5000, 3)) * (1, 10, 100)
    found, thinned = Statistics(), Statistics(most_kept=700)
    for part in np.array_split(rows, 37):
        found.add(part)
        thinned.add(part)
    for name, values in statistics(rows).items():
        np.testing.assert_allclose(found.summary()[name], values, rtol=1e-9)
        exact = not name.startswith("q")
        np.testing.assert_allclose(thinned.summary()[name], values, rtol=1e-9 if exact else 1e-3)
    np.testing.assert_allclose(found.summary()["std"], rows.std(axis=0), rtol=1e-9)
