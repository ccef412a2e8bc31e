"""`dynaforge export`: demonstrations in the format of another library, with a card."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Iterator

from tqdm import tqdm

from dynaforge.cli.dataset_arguments import open_dataset
from dynaforge.demos import DemonstrationDataset, Episode
from dynaforge.demos.exporters import Frames, exporter, read_frames
from dynaforge.demos.observations import FOLDER, ObservationFolder
from dynaforge.reports.card import write_card


def run(options: argparse.Namespace) -> int:
    """Export everything, whole or not at all."""
    write = exporter(options.format)
    dataset, task = open_dataset(options)
    source = options.folder.resolve()
    out = options.out or source.with_name(f"{source.name}-{options.format}")
    if out.exists():
        raise FileExistsError(f"{out} exists already. Choose another --out, or remove it.")
    observations = _observations(options, dataset)
    kept: list[Episode] = []
    names: tuple[str, ...] = ()

    def frames() -> Iterator[Frames]:
        nonlocal names
        found = read_frames(
            dataset,
            fps=task.scene.fps,
            actions=options.actions,
            observations=observations,
            failures=options.failures,
        )
        for episode in tqdm(found, total=len(dataset), leave=False, unit="episode"):
            kept.append(episode.episode)
            names = episode.action_names
            yield episode

    temporary = out.with_name(f".{out.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    try:
        n = write(temporary, task, frames())
        problem = write_card(
            temporary, task, dataset.attempts(), kept, layout=options.format, licence=options.license, actions=names,
            command=options.command, observations=observations,
        )  # fmt: skip
        os.replace(temporary, out)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    if problem:
        print(f"no contact sheet: {problem}")
    print(f"{n} demonstrations, {sum(map(len, kept))} steps, {size / 1e6:.1f} MB: {out}")
    return 0


def _observations(options: argparse.Namespace, dataset: DemonstrationDataset) -> ObservationFolder | None:
    path = options.observations or options.folder / FOLDER
    if options.observations is None and not path.is_dir():
        return None
    folder = ObservationFolder(path)
    if missing := folder.missing(dataset.ids()):
        raise FileNotFoundError(
            f"{path} lacks {len(missing)} of {len(dataset.ids())} episodes. `dynaforge render` as before adds them."
        )
    return folder
