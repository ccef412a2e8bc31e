"""`dynaforge view`: one HTML page to look through a folder of demonstrations."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
from tqdm import tqdm

from dynaforge.cli.dataset_arguments import open_dataset
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.reports.extras import load_extra
from dynaforge.reports.scene3d import Scene3D, SceneRecorder, write_rerun, write_viser
from dynaforge.reports.viewer import Filmer, Shown, write_viewer
from dynaforge.tasks import Task

# By the option, which is called as the module and the extra it needs.
SCENES: dict[str, tuple[str, str, Callable[[Path, Scene3D], None]]] = {  # title, suffix, writer
    "viser": ("scene in 3-D", ".html", write_viser),
    "rerun": ("for Rerun's viewer", ".rrd", write_rerun),
}


def run(options: argparse.Namespace) -> int:
    """Write the page."""
    dataset, task = open_dataset(options)
    attempts = dataset.attempts()
    chosen = spread(attempts, set(dataset.ids()), options.limit)
    out = options.out or options.folder / "view.html"
    wanted = [name for name in SCENES if getattr(options, name)]
    for name in wanted:  # said before the work
        load_extra(name, extra=name)
    shown = recordings(dataset, task, chosen, out, clips=not options.no_clips, scenes=wanted)
    write_viewer(out, task, attempts, shown, title=f"{task.env_name}: {options.folder}")
    print(f"{len(chosen)} recordings of {len(attempts)} attempts, {out.stat().st_size / 1e6:.1f} MB: {out}")
    if wanted and chosen:
        print(f"scenes in three dimensions, linked from it: {scene_folder(out)}")
    return 0


def spread(attempts: Sequence[Attempt], recorded: set[str], limit: int) -> list[str]:
    """Choose recordings evenly over the difficulties."""
    held = sorted((a for a in attempts if a.id in recorded), key=lambda attempt: attempt.difficulty)
    rows = np.unique(np.linspace(0, len(held) - 1, min(limit, len(held))).astype(int)) if held else np.arange(0)
    return [held[row].id for row in rows.tolist()]


def recordings(
    dataset: DemonstrationDataset, task: Task, chosen: Sequence[str], out: Path, *, clips: bool, scenes: Sequence[str]
) -> Iterator[Shown]:
    """Yield what the page shows of each; scenes are written on the way."""
    with ExitStack() as stack:
        filmer = stack.enter_context(closing(Filmer(task))) if clips else None
        recorder = stack.enter_context(closing(SceneRecorder(task))) if scenes else None
        for name in tqdm(chosen, leave=False, unit="episode"):
            episode = dataset[name]
            links = {}
            if recorder and len(episode):
                scene = recorder.record(episode)
                for option in scenes:
                    title, suffix, write = SCENES[option]
                    path = scene_folder(out) / f"{name}{suffix}"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    write(path, scene)
                    links[title] = f"{path.parent.name}/{path.name}"
            try:
                clip = filmer.film(episode) if filmer else None
            except ValueError as error:
                raise ValueError(f"{error} `--no-clips` makes a page of plots.") from error
            yield Shown(episode, clip, links)


def scene_folder(page: Path) -> Path:
    """Return where a page's scenes are."""
    return page.with_name(f"{page.stem}-scenes")
