"""`dynaforge view`: one HTML page to look through a folder of demonstrations."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np
from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos import Attempt, DemonstrationDataset, Episode
from dynaforge.demos.observation_file import SETTINGS
from dynaforge.demos.observations import FOLDER, ObservationFolder
from dynaforge.reports.extras import load_extra
from dynaforge.reports.scene3d import Scene3D, SceneRecorder, write_rerun, write_viser
from dynaforge.reports.viewer import write_viewer
from dynaforge.reports.viewer_clips import Filmer, Shown, camera_films
from dynaforge.sampling.processes import worker_pool
from dynaforge.tasks import Task

# By the option, which is called as the module and the extra it needs.
SCENES: dict[str, tuple[str, str, Callable[[Path, Scene3D], None]]] = {  # title, suffix, writer
    "viser": ("scene in 3-D", ".html", write_viser),
    "rerun": ("for Rerun's viewer", ".rrd", write_rerun),
}


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the page is to show of each recording.

    Attributes:
        folder, task: The dataset.
        page: The page's file, beside which scenes are written.
        clips: Whether to film.
        scenes: Names in `SCENES`.
        observations: Where rendered observations are; None for none.
    """

    folder: Path
    task: Task
    page: Path
    clips: bool
    scenes: tuple[str, ...]
    observations: Path | None


def run(options: argparse.Namespace) -> int:
    """Write the page; returns 1 where a recording could not be shown as it should."""
    dataset, task = open_dataset(options)
    attempts, recorded = dataset.attempts(), set(dataset.ids())
    chosen = spread(attempts, recorded, options.limit)
    out = options.out
    scenes = tuple(name for name in SCENES if getattr(options, name))
    clips = not options.no_clips
    for module in ("jinja2", *(["imageio_ffmpeg"] if clips else [])):  # said before the work
        load_extra(module)
    for name in scenes:
        load_extra(name, extra=name)
    wanted = Wanted(options.folder, task, out, clips, scenes, _observations(options) if clips else None)
    shown = list(tqdm(recordings(wanted, chosen, options.workers), total=len(chosen), leave=False, unit="episode"))
    amiss = [one for one in shown if one.note]
    if clips and len(amiss) == len(shown) > 0 and not any(one.clip for one in shown):
        raise ValueError(f"{amiss[0].note} `--no-clips` makes a page of plots.")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_viewer(out, task, attempts, shown, title=f"{task.env_name}: {options.folder}", recorded=recorded)
    print(f"{len(chosen)} recordings of {len(attempts)} attempts, {out.stat().st_size / 1e6:.1f} MB: {out}")
    if scenes and chosen:
        print(f"scenes in three dimensions, linked from it: {scene_folder(out)}")
    for one in amiss:
        print(f"{one.id}: {one.note}")
    return 1 if amiss else 0


def spread(attempts: Sequence[Attempt], recorded: set[str], limit: int) -> list[str]:
    """Choose recordings evenly over the difficulties."""
    held = sorted((a for a in attempts if a.id in recorded), key=lambda attempt: attempt.difficulty)
    rows = np.unique(np.linspace(0, len(held) - 1, min(limit, len(held))).astype(int)) if held else np.arange(0)
    return [held[row].id for row in rows.tolist()]


def recordings(wanted: Wanted, chosen: Sequence[str], workers: int) -> Iterator[Shown]:
    """Yield what the page shows of each, made on so many cores; scenes are written on the way.

    Raises:
        OSError: A worker died.
    """
    workers = min(workers, len(chosen))
    if workers <= 1:
        with closing(Maker(wanted)) as maker:
            yield from map(maker.make, chosen)
        return
    with worker_pool(workers, _start, wanted) as pool:
        try:
            yield from pool.map(_make, chosen)
        except BrokenProcessPool:
            raise OSError("A worker process died, perhaps for want of memory; try fewer --workers.") from None


class Maker:
    """Makes what the page shows of one recording after another, opening what it needs once.

    Args:
        wanted: What that is.
    """

    def __init__(self, wanted: Wanted) -> None:
        self._wanted, self._stack = wanted, ExitStack()
        self._dataset = DemonstrationDataset(wanted.folder)
        self._observations = ObservationFolder(wanted.observations) if wanted.observations else None
        self._filmer = self._stack.enter_context(closing(Filmer(wanted.task))) if wanted.clips else None
        self._recorder = self._stack.enter_context(closing(SceneRecorder(wanted.task))) if wanted.scenes else None

    def make(self, name: str) -> Shown:
        """Return it; what cannot be read or simulated again is noted."""
        try:
            episode = self._dataset[name]
        except (KeyError, ValueError, OSError) as error:
            return Shown(name, None, note=f"The recording cannot be read: {error}")
        clip, scenes, views, notes = None, {}, {}, []
        try:
            clip = self._filmer.film(episode) if self._filmer and len(episode) else None
            scenes = self._scenes(episode)
        except ValueError as error:
            notes.append(str(error))
        try:
            if self._observations and self._observations.file_of(name).is_file():
                views = camera_films(self._observations, episode, control_dt=self._wanted.task.scene.control_dt)
        except (ValueError, OSError) as error:
            notes.append(f"No views of its cameras: {error}")
        return Shown(name, episode, clip, views, scenes, " ".join(notes))

    def close(self) -> None:
        """Release physics; legal twice."""
        self._stack.close()

    def _scenes(self, episode: Episode) -> dict[str, str]:
        links: dict[str, str] = {}
        if self._recorder and len(episode):
            scene, folder = self._recorder.record(episode), scene_folder(self._wanted.page)
            folder.mkdir(parents=True, exist_ok=True)
            for option in self._wanted.scenes:
                title, suffix, write = SCENES[option]
                write(folder / f"{episode.id}{suffix}", scene)
                links[title] = quote(f"{folder.name}/{episode.id}{suffix}", errors="replace")
        return links


_maker: Maker | None = None


def _start(wanted: Wanted) -> None:
    global _maker
    _maker = Maker(wanted)


def _make(name: str) -> Shown:
    assert _maker is not None
    return _maker.make(name)


def scene_folder(page: Path) -> Path:
    """Return where a page's scenes are."""
    return page.with_name(f"{page.stem}-scenes")


def _observations(options: argparse.Namespace) -> Path | None:
    """Return the folder of rendered observations; None without one.

    Raises:
        DamagedFileError: Its settings cannot be read.
    """
    path: Path = options.observations or options.folder / FOLDER
    if not options.observations and not (path / SETTINGS).exists():
        return None
    return ObservationFolder(path).path  # said before the work
