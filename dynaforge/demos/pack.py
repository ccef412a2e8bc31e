"""A disposable copy of a dataset for training: memory-mapped arrays, all episodes one after another.

A dataset's own files are made to be kept; reading two frames out of one takes milliseconds. From the pack it takes
hundredths of one. It can be deleted and made again at any time.
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
from dynaforge.demos.untrusted import MALFORMED, DamagedFileError, kind_of, printable, read_json

ABOUT = "pack.json"
ENDS = "episode_ends"
LONGEST = 10_000  # frames that a window may reach to either side: no episode is as long
MOST_EPISODES = 10**7
REMEDY = "write the pack"  # how a damaged file is made again


class Pack:
    """Frames of many episodes in memory-mapped arrays, read in windows that stay within an episode.

    A pack pickles as the name of its folder, so that workers of a data loader open the same files.

    Attributes:
        folder: Where it is.
        arrays: `state` (N, 15), `action` (N, A), `dq` (N, 7), `phase` (N), `gate` (N), `contact` (N, 2), and `points`
            (N, P, 3) where rendered, by name.
        episode_ends: Index of the first frame after each episode, shape (E,).
        action_names: Names of the components of an action.

    Args:
        folder: As `Pack.write` left it.

    Raises:
        FileNotFoundError: It holds no pack.
        DamagedFileError: A file of it cannot be read, or does not fit the others.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).absolute()
        self.action_names, names = _about(self.folder)
        self.arrays = {name: _open(self.folder, name) for name in names}
        ends = _open(self.folder, ENDS)
        self.episode_ends: NDArray[np.int64] = np.array(ends[:MOST_EPISODES])
        lengths = np.diff(self.episode_ends, prepend=0)
        frames = {name: len(array) for name, array in self.arrays.items()}
        if self.episode_ends.dtype != np.int64 or not len(lengths) or (lengths <= 0).any():
            raise DamagedFileError(self.folder / f"{ENDS}.npy", "it is no list of increasing ends", remedy=REMEDY)
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
        """Read frames `frame - before` to `frame + after`; beyond an end of the episode its own end is repeated.

        Args:
            name: Of an array.
            frame: Index of a frame, 0 to len - 1.
            before, after: Frames on either side, at most 10000.

        Raises:
            KeyError: There is no such array.
            IndexError: There is no such frame.
            ValueError: `before` or `after` is negative, or longer than any episode.
            TypeError: One of the three is no whole number.
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
        """Write a pack; one already there is replaced once the new one is whole.

        Episode by episode: all of them together may not fit into memory.

        Raises:
            FileExistsError: The folder holds something else.
            ValueError: There is no episode, or some have points and some have none.
        """
        folder = Path(folder)
        if folder.exists() and not (folder / ABOUT).is_file() and not (folder.is_dir() and not any(folder.iterdir())):
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
    arrays: dict[str, _Growing] = {}
    with contextlib.ExitStack() as files:
        for episode in episodes:
            rows = dict(_rows(episode))
            if not lengths:
                arrays = {name: files.enter_context(_growing(folder, name, row)) for name, row in rows.items()}
            if rows.keys() != arrays.keys():
                raise ValueError("Some demonstrations were rendered and some were not; run dynaforge render again.")
            for name, row in rows.items():
                arrays[name].add(row)
            lengths.append(len(episode))
            names = episode.action_names
            del episode, rows, row  # or they lived on while the next is read
    if not lengths:
        raise ValueError("There is no demonstration to pack.")
    np.save(folder / f"{ENDS}.npy", np.cumsum(lengths, dtype=np.int64))
    (folder / ABOUT).write_text(json.dumps({"arrays": list(arrays), "action_names": names}))


def _rows(episode: Frames) -> Iterator[tuple[str, NDArray[Any]]]:
    yield from episode.low_dimensional.items()
    if episode.points is not None:
        yield "points", episode.points.astype(np.float16)  # 0.24 mm at most, half the size


class _Growing:
    """A .npy file that rows are added to: numpy leaves room in its header for the number of rows.

    Args:
        file: Open for writing, empty.
        like: An array of the same type and shape but for the number of rows.
    """

    def __init__(self, file: BinaryIO, like: NDArray[Any]) -> None:
        self._file, self._like, self._n = file, like[:0].copy(), 0
        self._write_header()

    def add(self, rows: NDArray[Any]) -> None:
        """Add rows at the end."""
        self._file.write(np.ascontiguousarray(rows, dtype=self._like.dtype).tobytes())
        self._n += len(rows)

    def finish(self) -> None:
        """Write into the header how many rows there are."""
        self._file.seek(0)
        self._write_header()

    def _write_header(self) -> None:
        header: Mapping[str, Any] = np.lib.format.header_data_from_array_1_0(self._like)
        shape = (self._n, *self._like.shape[1:])
        np.lib.format.write_array_header_1_0(self._file, {**header, "shape": shape})


@contextlib.contextmanager
def _growing(folder: Path, name: str, like: NDArray[Any]) -> Iterator[_Growing]:
    with (folder / f"{name}.npy").open("wb") as file:
        array = _Growing(file, like)
        yield array
        array.finish()


def _about(folder: Path) -> tuple[tuple[str, ...], list[str]]:
    """Return the names of an action's components, and of the arrays."""
    path = folder / ABOUT
    try:
        data = read_json(path, remedy=REMEDY)
    except FileNotFoundError:
        raise FileNotFoundError(f"{printable(folder)} holds no pack.") from None
    actions, arrays = (data.get("action_names"), data.get("arrays")) if isinstance(data, dict) else (None, None)
    if not (
        isinstance(actions, list) and isinstance(arrays, list) and all(isinstance(n, str) for n in actions + arrays)
    ):
        raise DamagedFileError(path, "it does not describe a pack", remedy=REMEDY)
    if odd := [name for name in arrays if not re.fullmatch(r"[A-Za-z_]+", name)]:
        raise DamagedFileError(path, f"{odd[0]!r:.80} is no name of an array", remedy=REMEDY)
    return tuple(actions), arrays


def _open(folder: Path, name: str) -> NDArray[Any]:
    """Map an array into memory, without reading it."""
    path = folder / f"{name}.npy"
    if (kind := kind_of(path)) != "a file":
        raise DamagedFileError(path, f"it is {kind or 'missing'}", remedy=REMEDY)
    try:
        array: NDArray[Any] = np.load(path, mmap_mode="r")
    except MALFORMED as error:
        raise DamagedFileError(path, f"it is no array ({printable(error)})", remedy=REMEDY) from error
    if array.ndim < 1 or array.dtype.kind not in "biuf":
        raise DamagedFileError(path, "it is no array of numbers", remedy=REMEDY)
    return array
