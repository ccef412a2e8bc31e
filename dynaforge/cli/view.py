"""`dynaforge view`: one HTML page to look through a folder of demonstrations."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from tqdm import tqdm

from dynaforge.cli.dataset_arguments import add_dataset_arguments, open_dataset
from dynaforge.demos import Episode
from dynaforge.reports.viewer import Filmer, write_viewer


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Add the options of `view`."""
    add_dataset_arguments(parser)
    parser.add_argument(
        "--limit", type=int, default=40, help="recordings with clip and plots, spread over the difficulties"
    )
    parser.add_argument("--no-clips", action="store_true", help="plots only, in a tenth of the time")
    parser.add_argument("--out", type=Path, help="HTML file (default: view.html in the folder)")


def run(options: argparse.Namespace) -> int:
    """Write the page."""
    dataset, task = open_dataset(options)
    attempts = dataset.attempts()
    recorded = set(dataset.ids())
    held = sorted((a for a in attempts if a.id in recorded), key=lambda attempt: attempt.difficulty)
    spread = np.unique(np.linspace(0, len(held) - 1, min(options.limit, len(held))).astype(int))
    chosen = [held[row].id for row in spread.tolist()] if held else []
    out = options.out or options.folder / "view.html"
    filmer = None if options.no_clips else Filmer(task)

    def episodes() -> Iterator[tuple[Episode, bytes | None]]:
        for name in tqdm(chosen, leave=False, unit="episode"):
            episode = dataset[name]
            yield episode, filmer.film(episode) if filmer else None

    write_viewer(out, task, attempts, episodes(), title=f"{task.env_name}: {options.folder}")
    if filmer:
        filmer.close()
    print(f"{len(chosen)} recordings of {len(attempts)} attempts, {out.stat().st_size / 1e6:.1f} MB: {out}")
    return 0
