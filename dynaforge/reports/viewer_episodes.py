"""What the page of a dataset shows of its recordings, made on all cores: clips, camera views, scenes in 3-D."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from dynaforge.demos import Attempt, DemonstrationDataset, Episode
from dynaforge.demos.observations import ObservationFolder
from dynaforge.reports.extras import load_extra
from dynaforge.reports.scene3d import Scene3D, SceneRecorder, write_rerun, write_viser
from dynaforge.reports.viewer_clips import Filmer, ViewerEpisode, camera_films
from dynaforge.sampling.processes import worker_pool
from dynaforge.tasks import Task

# The names are those of the command's options, and of the module and the extra that each needs.
SCENES: dict[str, tuple[str, str, Callable[[Path, Scene3D], None]]] = {  # title, file ending, writer
    "viser": ("scene in 3-D", ".html", write_viser),
    "rerun": ("for Rerun's viewer", ".rrd", write_rerun),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptions:
    """What the page shows of each recording.

    Attributes:
        folder: The dataset.
        task: Its task.
        page: File of the page, beside which scenes are written.
        clips: Whether to make films.
        scenes: Names in `SCENES`.
        observations: Folder of rendered observations; None for none.
    """

    folder: Path
    task: Task
    page: Path
    clips: bool = True
    scenes: tuple[str, ...] = ()
    observations: Path | None = None

    def load_extras(self) -> None:
        """Import the optional packages that the page needs, so that a missing one is reported before any work.

        Raises:
            ImportError: One is not installed.
        """
        for module in ("jinja2", *(["imageio_ffmpeg"] if self.clips else [])):
            load_extra(module)
        for name in self.scenes:
            load_extra(name, extra=name)


def spread_over_difficulties(attempts: Sequence[Attempt], recorded: set[str], limit: int) -> list[str]:
    """Choose recordings spread evenly over the difficulties.

    Args:
        attempts: All attempts of the dataset.
        recorded: Ids of those that it has recordings of.
        limit: How many to choose at most.

    Returns:
        Ids, the easiest first.
    """
    candidates = sorted((a for a in attempts if a.id in recorded), key=lambda attempt: attempt.difficulty)
    if not candidates:
        return []
    rows = np.unique(np.linspace(0, len(candidates) - 1, min(limit, len(candidates))).astype(int))
    return [candidates[row].id for row in rows.tolist()]


def viewer_episodes(options: ViewOptions, ids: Sequence[str], *, workers: int = 1) -> Iterator[ViewerEpisode]:
    """Yield what the page shows of each recording, in order, and write their scenes.

    Args:
        options: What the page shows.
        ids: Ids of the recordings.
        workers: Number of processes.

    Raises:
        OSError: A worker died.
    """
    workers = min(workers, len(ids))
    if workers <= 1:
        with closing(EpisodeMaker(options)) as maker:
            yield from map(maker.make, ids)
        return
    with worker_pool(workers, _start, options) as pool:
        try:
            yield from pool.map(_make, ids)
        except BrokenProcessPool:
            raise OSError("A worker process died, perhaps for want of memory; try fewer --workers.") from None


class EpisodeMaker:
    """Makes what the page shows of one recording after another, with dataset and physics opened once.

    Args:
        options: What the page shows.
    """

    def __init__(self, options: ViewOptions) -> None:
        self._options, self._stack = options, ExitStack()
        self._dataset = DemonstrationDataset(options.folder)
        self._observations = ObservationFolder(options.observations) if options.observations else None
        self._filmer = self._stack.enter_context(closing(Filmer(options.task))) if options.clips else None
        self._recorder = self._stack.enter_context(closing(SceneRecorder(options.task))) if options.scenes else None

    def make(self, name: str) -> ViewerEpisode:
        """Return what the page shows of a recording; a note says what cannot be read or simulated again."""
        try:
            episode = self._dataset[name]
        except (KeyError, ValueError, OSError) as error:
            return ViewerEpisode(id=name, episode=None, note=f"The recording cannot be read: {error}")
        clip, scenes, views, notes = None, {}, {}, []
        try:
            clip = self._filmer.film(episode) if self._filmer and len(episode) else None
            scenes = self._scenes(episode)
        except ValueError as error:
            notes.append(str(error))
        try:
            if self._observations and self._observations.file_of(name).is_file():
                views = camera_films(self._observations, episode, control_dt=self._options.task.scene.control_dt)
        except (ValueError, OSError) as error:
            notes.append(f"No views of its cameras: {error}")
        return ViewerEpisode(id=name, episode=episode, clip=clip, views=views, scenes=scenes, note=" ".join(notes))

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._stack.close()

    def _scenes(self, episode: Episode) -> dict[str, str]:
        """Write the scenes of an episode; return the links to them by their titles."""
        links: dict[str, str] = {}
        if self._recorder and len(episode):
            scene, folder = self._recorder.record(episode), scene_folder(self._options.page)
            folder.mkdir(parents=True, exist_ok=True)
            for option in self._options.scenes:
                title, suffix, write = SCENES[option]
                write(folder / f"{episode.id}{suffix}", scene)
                links[title] = quote(f"{folder.name}/{episode.id}{suffix}", errors="replace")
        return links


def scene_folder(page: Path) -> Path:
    """Return the folder of a page's scenes."""
    return page.with_name(f"{page.stem}-scenes")


_maker: EpisodeMaker | None = None  # that of this worker process


def _start(options: ViewOptions) -> None:
    global _maker
    _maker = EpisodeMaker(options)


def _make(name: str) -> ViewerEpisode:
    assert _maker is not None
    return _maker.make(name)
