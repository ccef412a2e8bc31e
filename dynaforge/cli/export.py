"""`dynaforge export`: demonstrations in the format of another library, with a card."""

from __future__ import annotations

import argparse

from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.exporters import exporter, read_frames
from dynaforge.demos.observations import FOLDER, ObservationFolder
from dynaforge.reports.export import ExportOptions, export_dataset


def run(options: argparse.Namespace) -> int:
    """Export the dataset, completely or not at all."""
    exporter(options.format)  # a missing library is reported before anything is read
    dataset, task = open_dataset(options)
    observations = _observations(options, dataset)
    frames = read_frames(
        dataset,
        fps=task.scene.fps,
        actions=options.actions,
        rotation=options.rotation,
        elbow=not options.no_elbow,
        observations=observations,
        depth=options.depth or options.format != "lerobot",
        privileged=True if options.privileged else None,
        failures=options.failures,
    )
    episodes = tqdm(frames, total=len(dataset), leave=False, unit="episode")
    settings = ExportOptions(
        layout=options.format,
        licence=options.license,
        command=options.command,
        replays=options.replays,
        observations=observations,
    )
    result = export_dataset(dataset, task, episodes, options.out, settings)
    size = sum(path.stat().st_size for path in options.out.rglob("*") if path.is_file())
    if result.no_sheet:
        print(f"no contact sheet: {result.no_sheet}")
    if result.replayed:
        print(result.replayed)
    print(f"{result.demonstrations} demonstrations, {result.steps} steps, {size / 1e6:.1f} MB: {options.out}")
    return 0


def _observations(options: argparse.Namespace, dataset: DemonstrationDataset) -> ObservationFolder | None:
    """Return the rendered observations; None without any, or where the format cannot contain them.

    Raises:
        ValueError: Observations were named, and the format cannot contain them.
        FileNotFoundError: Not all episodes are rendered.
    """
    path = options.observations or options.folder / FOLDER
    if options.no_observations or (options.observations is None and not path.is_dir()):
        return None
    folder = ObservationFolder(path)
    if options.format == "minari" or (options.format == "lerobot" and not folder.settings.images):
        lacking = "neither pictures nor points" if options.format == "minari" else "no points"
        if options.observations is not None:
            raise ValueError(f"Format {options.format} holds {lacking}; leave --observations out.")
        return None
    if missing := folder.missing(dataset.ids()):
        raise FileNotFoundError(
            f"{path} lacks {len(missing)} of {len(dataset.ids())} episodes. `dynaforge render` as before adds them."
        )
    return folder
