"""A disposable copy of a dataset for training: memory-mapped arrays, all episodes one after another.

The files of a dataset are made to be kept: reading two frames from one takes milliseconds. From a pack it takes
hundredths of a millisecond. A pack can be deleted and made again at any time.
"""

from __future__ import annotations

import contextlib
import difflib
import json
import operator
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.exporters.frames import Frames
from dynaforge.demos.untrusted import MALFORMED_FILE_ERRORS, DamagedFileError, kind_of, printable, read_json

METADATA = "pack.json"
EPISODE_ENDS = "episode_ends"
LONGEST = 10_000  # frames that a window may extend to either side: longer than any episode
MOST_EPISODES = 10**7
REMEDY = "write the pack"  # how a damaged file is made again


class Pack:
    """Frames of many episodes in memory-mapped arrays, read in windows that stay within an episode.

    A pack pickles as the name of its folder, so that workers of a data loader open the same files.

    Attributes:
        folder: Its folder.
        arrays: By name: `state` (N, 15), `action` (N, A), `dq` (N, 7), `phase` (N), `gate` (N), `contact` (N, 2), and
            `points` (N, P, 3) if they were rendered.
        episode_ends: Index of the first frame after each episode, shape (E,).
        action_names: Names of the components of an action.

    Args:
        folder: A folder that `Pack.write` made.

    Raises:
        FileNotFoundError: It contains no pack.
        DamagedFileError: One of its files cannot be read, or does not fit the others.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).absolute()
        self.action_names, names = _read_metadata(self.folder)
        self.arrays = {name: _open(self.folder, name) for name in names}
        ends = _open(self.folder, EPISODE_ENDS)
        self.episode_ends: NDArray[np.int64] = np.array(ends[:MOST_EPISODES])
        lengths = np.diff(self.episode_ends, prepend=0)
        frames = {name: len(array) for name, array in self.arrays.items()}
        if self.episode_ends.dtype != np.int64 or not len(lengths) or (lengths <= 0).any():
            raise DamagedFileError(
                self.folder / f"{EPISODE_ENDS}.npy", "it is no list of increasing ends", remedy=REMEDY
            )
        if odd := [name for name, n in frames.items() if n != self.episode_ends[-1]]:
            reason = f"it holds {frames[odd[0]]} frames, the episodes {self.episode_ends[-1]}"
            raise DamagedFileError(self.folder / f"{odd[0]}.npy", reason, remedy=REMEDY)
        self._first = np.repeat(self.episode_ends - lengths, lengths)
        self._last = np.repeat(self.episode_ends - 1, lengths)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._first)

    def __reduce__(self) -> tuple[Any, ...]:
        return Pack, (str(self.folder),)

    def window(self, name: str, frame: int, *, before: int, after: int) -> NDArray[Any]:
        """Read frames `frame - before` to `frame + after`; beyond an end of the episode, its end frame is repeated.

        Args:
            name: Name of an array.
            frame: Index of a frame, 0 to len - 1.
            before: Frames before it, at most 10000.
            after: Frames after it, likewise.

        Raises:
            KeyError: There is no such array.
            IndexError: There is no such frame.
            ValueError: `before` or `after` is negative, or longer than any episode.
            TypeError: `frame`, `before` or `after` is no whole number.
        """
        if name not in self.arrays:
            close = difflib.get_close_matches(str(name), self.arrays, n=1)
            hint = f" Did you mean {close[0]!r}?" if close else ""
            raise KeyError(f"No array {name!r} in {self.folder}; there are {', '.join(self.arrays)}.{hint}")
        frame, before, after = map(operator.index, (frame, before, after))
        if not 0 <= frame < len(self):
            raise IndexError(f"No frame {frame}; the pack has frames 0 to {len(self) - 1}.")
        for side, reach in (("before", before), ("after", after)):
            if not 0 <= reach <= LONGEST:
                raise ValueError(f"A window reaches 0 to {LONGEST} frames to either side; {side} is {reach}.")
        low, high = int(self._first[frame]), int(self._last[frame])
        if low <= frame - before and frame + after <= high:
            return np.asarray(self.arrays[name][frame - before : frame + after + 1])
        rows = np.arange(frame - before, frame + after + 1).clip(low, high)
        return np.asarray(self.arrays[name][rows])

    @staticmethod
    def write(folder: str | Path, episodes: Iterable[Frames]) -> Pack:
        """Write a pack; an existing one is replaced once the new one is complete.

        Episodes are written one by one, since all together may not fit into memory.

        Args:
            folder: New, empty, or that of an earlier pack.
            episodes: What to pack, such as `read_frames` returns.

        Raises:
            FileExistsError: The folder contains something else.
            ValueError: There is no episode, or some have points and some have none.
        """
        folder = Path(folder)
        if (
            folder.exists()
            and not (folder / METADATA).is_file()
            and not (folder.is_dir() and not any(folder.iterdir()))
        ):
            raise FileExistsError(f"{folder} holds something other than a pack. Choose another folder.")
        temporary = folder.with_name(f".{folder.name}.tmp")
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        try:
            _write(temporary, episodes)
            shutil.rmtree(folder, ignore_errors=True)
            temporary.rename(folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        return Pack(folder)


def _write(folder: Path, episodes: Iterable[Frames]) -> None:
    lengths: list[int] = []
    names: tuple[str, ...] = ()
    arrays: dict[str, _GrowingArray] = {}
    with contextlib.ExitStack() as files:
        for episode in episodes:
            rows = dict(_rows(episode))
            if not lengths:
                arrays = {name: files.enter_context(_growing_array(folder, name, row)) for name, row in rows.items()}
            if rows.keys() != arrays.keys():
                raise ValueError("Some demonstrations were rendered and some were not; run dynaforge render again.")
            for name, row in rows.items():
                arrays[name].add(row)
            lengths.append(len(episode))
            names = episode.action_names
            del episode, rows, row  # free their memory before the next is read
    if not lengths:
        raise ValueError("There is no demonstration to pack.")
    np.save(folder / f"{EPISODE_ENDS}.npy", np.cumsum(lengths, dtype=np.int64))
    (folder / METADATA).write_text(json.dumps({"arrays": list(arrays), "action_names": names}))


def _rows(episode: Frames) -> Iterator[tuple[str, NDArray[Any]]]:
    yield from episode.low_dimensional.items()
    if episode.points is not None:
        yield "points", episode.points.astype(np.float16)  # half the size, at an error of 0.24 mm at most


class _GrowingArray:
    """A .npy file that rows are appended to: numpy leaves room in its header for the number of rows.

    Args:
        file: An empty file, open for writing.
        like: An array of the same type, and of the same shape apart from the number of rows.
    """

    def __init__(self, file: BinaryIO, like: NDArray[Any]) -> None:
        self._file, self._like, self._n = file, like[:0].copy(), 0
        self._write_header()

    def add(self, rows: NDArray[Any]) -> None:
        """Append rows."""
        self._file.write(np.ascontiguousarray(rows, dtype=self._like.dtype).tobytes())
        self._n += len(rows)

    def finish(self) -> None:
        """Write the number of rows into the header."""
        self._file.seek(0)
        self._write_header()

    def _write_header(self) -> None:
        header: Mapping[str, Any] = np.lib.format.header_data_from_array_1_0(self._like)
        shape = (self._n, *self._like.shape[1:])
        np.lib.format.write_array_header_1_0(self._file, {**header, "shape": shape})


@contextlib.contextmanager
def _growing_array(folder: Path, name: str, like: NDArray[Any]) -> Iterator[_GrowingArray]:
    with (folder / f"{name}.npy").open("wb") as file:
        array = _GrowingArray(file, like)
        yield array
        array.finish()


def _read_metadata(folder: Path) -> tuple[tuple[str, ...], list[str]]:
    """Return the names of the components of an action, and of the arrays."""
    path = folder / METADATA
    try:
        data = read_json(path, remedy=REMEDY)
    except FileNotFoundError:
        raise FileNotFoundError(f"{printable(folder)} holds no pack.") from None
    if not isinstance(data, dict) or not all(_is_list_of_names(data.get(key)) for key in ("action_names", "arrays")):
        raise DamagedFileError(path, "it does not describe a pack", remedy=REMEDY)
    arrays: list[str] = data["arrays"]
    if odd := [name for name in arrays if not re.fullmatch(r"[A-Za-z_]+", name)]:
        raise DamagedFileError(path, f"{odd[0]!r:.80} is no name of an array", remedy=REMEDY)
    return tuple(data["action_names"]), arrays


def _is_list_of_names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)


def _open(folder: Path, name: str) -> NDArray[Any]:
    """Map an array into memory without reading it."""
    path = folder / f"{name}.npy"
    if (kind := kind_of(path)) != "a file":
        raise DamagedFileError(path, f"it is {kind or 'missing'}", remedy=REMEDY)
    try:
        array: NDArray[Any] = np.load(path, mmap_mode="r")
    except MALFORMED_FILE_ERRORS as error:
        raise DamagedFileError(path, f"it is no array ({printable(error)})", remedy=REMEDY) from error
    if array.ndim < 1 or array.dtype.kind not in "biuf":
        raise DamagedFileError(path, "it is no array of numbers", remedy=REMEDY)
    return array
