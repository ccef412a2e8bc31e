"""A disposable copy of a dataset for training: memory-mapped arrays, all episodes one after another.

A dataset's own files are made to be kept; reading two frames out of one takes milliseconds. From the pack it takes
hundredths of one. It can be deleted and made again at any time.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.exporters.frames import Frames

ABOUT = "pack.json"
ENDS = "episode_ends"


class Pack:
    """Frames of many episodes in memory-mapped arrays, read in windows that stay within an episode.

    Attributes:
        arrays: `state` (N, 15), `action` (N, A), and `points` (N, P, 3) where rendered, by name.
        episode_ends: Index of the first frame after each episode, shape (E,).
        action_names: Names of the components of an action.

    Args:
        folder: As `Pack.write` left it.

    Raises:
        FileNotFoundError: It holds no pack.
    """

    def __init__(self, folder: str | Path) -> None:
        folder = Path(folder)
        about = folder / ABOUT
        if not about.is_file():
            raise FileNotFoundError(f"{folder} holds no pack.")
        data = json.loads(about.read_text())
        self.action_names: tuple[str, ...] = tuple(data["action_names"])
        self.arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in data["arrays"]}
        self.episode_ends: NDArray[np.int64] = np.load(folder / f"{ENDS}.npy")
        lengths = np.diff(self.episode_ends, prepend=0)
        self._first = np.repeat(self.episode_ends - lengths, lengths)
        self._last = np.repeat(self.episode_ends - 1, lengths)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._first)

    def window(self, name: str, frame: int, *, before: int, after: int) -> NDArray[Any]:
        """Read frames `frame - before` to `frame + after`; beyond an end of the episode its own end is repeated.

        Args:
            name: Of an array.
            frame: Index of a frame, 0 to len - 1.
            before, after: Frames on either side.
        """
        low, high = int(self._first[frame]), int(self._last[frame])
        if low <= frame - before and frame + after <= high:
            return np.asarray(self.arrays[name][frame - before : frame + after + 1])
        rows = np.arange(frame - before, frame + after + 1).clip(low, high)
        return np.asarray(self.arrays[name][rows])

    @staticmethod
    def write(folder: str | Path, episodes: Iterable[Frames]) -> Pack:
        """Write a pack; one already there is replaced once the new one is whole.

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
        columns: dict[str, list[NDArray[Any]]] = {}
        lengths: list[int] = []
        names: tuple[str, ...] = ()
        for episode in episodes:
            rows = {"state": episode.state, "action": episode.actions}
            if episode.points is not None:
                rows["points"] = episode.points.astype(np.float16)  # 0.24 mm at most, half the size
            for name, row in rows.items():
                columns.setdefault(name, []).append(row)
            lengths.append(len(episode))
            names = episode.action_names
        if not lengths:
            raise ValueError("There is no demonstration to pack.")
        if any(len(parts) < len(lengths) for parts in columns.values()):
            raise ValueError("Some demonstrations were rendered and some were not; run dynaforge render again.")
        for name, parts in columns.items():
            np.save(temporary / f"{name}.npy", np.concatenate(parts))
        np.save(temporary / f"{ENDS}.npy", np.cumsum(lengths, dtype=np.int64))
        about = {"arrays": list(columns), "action_names": names}
        (temporary / ABOUT).write_text(json.dumps(about))
        shutil.rmtree(folder, ignore_errors=True)
        temporary.rename(folder)
        return Pack(folder)
