"""`dynaforge view`: one HTML page to look through a folder of demonstrations."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos.observation_file import SETTINGS
from dynaforge.demos.observations import FOLDER, ObservationFolder
from dynaforge.reports.viewer import write_viewer
from dynaforge.reports.viewer_clips import ViewerEpisode
from dynaforge.reports.viewer_episodes import (
    SCENES,
    ViewOptions,
    scene_folder,
    spread_over_difficulties,
    viewer_episodes,
)


def run(options: argparse.Namespace) -> int:
    """Write the page; return 1 where a recording could not be shown as it should."""
    dataset, task = open_dataset(options)
    attempts, recorded = dataset.attempts(), set(dataset.ids())
    chosen = spread_over_difficulties(attempts, recorded, options.limit)
    view = ViewOptions(
        folder=options.folder,
        task=task,
        page=options.out,
        clips=not options.no_clips,
        scenes=tuple(name for name in SCENES if getattr(options, name)),
        observations=None if options.no_clips else _observations(options),
    )
    view.load_extras()
    shown = viewer_episodes(view, chosen, workers=options.workers)
    episodes = list(tqdm(shown, total=len(chosen), leave=False, unit="episode"))
    noted = [episode for episode in episodes if episode.note]
    _refuse_a_page_without_clips(view, episodes, noted)
    view.page.parent.mkdir(parents=True, exist_ok=True)
    title = f"{task.env_name}: {options.folder}"
    write_viewer(view.page, task, attempts, episodes, title=title, recorded=recorded)
    size = view.page.stat().st_size / 1e6
    print(f"{len(chosen)} recordings of {len(attempts)} attempts, {size:.1f} MB: {view.page}")
    if view.scenes and chosen:
        print(f"scenes in three dimensions, linked from it: {scene_folder(view.page)}")
    for episode in noted:
        print(f"{episode.id}: {episode.note}")
    return 1 if noted else 0


def _refuse_a_page_without_clips(
    view: ViewOptions, episodes: Sequence[ViewerEpisode], noted: Sequence[ViewerEpisode]
) -> None:
    """Raise ValueError if clips were asked for and every recording has a note instead of one."""
    if view.clips and len(noted) == len(episodes) > 0 and not any(episode.clip for episode in episodes):
        raise ValueError(f"{noted[0].note} `--no-clips` makes a page of plots.")


def _observations(options: argparse.Namespace) -> Path | None:
    """Return the folder of rendered observations; None without one.

    Raises:
        DamagedFileError: Its settings cannot be read.
    """
    path: Path = options.observations or options.folder / FOLDER
    if not options.observations and not (path / SETTINGS).exists():
        return None
    return ObservationFolder(path).path  # opened here so that damage is reported before the work
