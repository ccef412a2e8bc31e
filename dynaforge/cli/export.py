"""`dynaforge export`: demonstrations in the format of another library, with a card."""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.exporters import Frames, exporter, read_frames
from dynaforge.demos.exporters.frames import Floats, env_of
from dynaforge.demos.observations import FOLDER, ObservationFolder
from dynaforge.generators.bridge import ExportBridge, acts_again
from dynaforge.reports.card import Exported, write_card
from dynaforge.sim import Condition
from dynaforge.tasks import Task
from dynaforge.tasks.action import ActionLayout


def run(options: argparse.Namespace) -> int:
    """Export everything, whole or not at all."""
    write = exporter(options.format)
    dataset, task = open_dataset(options)
    out = options.out
    if out.exists():
        raise FileExistsError(f"{out} exists already. Choose another --out, or remove it.")
    observations = _observations(options, dataset)
    found = read_frames(
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
    kept: list[Exported] = []
    contents: dict[str, str] = {}
    won: list[Played] = []

    def frames() -> Iterator[Frames]:
        for episode in tqdm(found, total=len(dataset), leave=False, unit="episode"):
            kept.append(Exported.of(episode.episode))
            contents.update(_contents(task, episode, options.format))
            if episode.success:
                won.append(Played(episode.layout, episode.episode.condition, episode.actions))
            yield episode
            del episode  # or it lived on while the next is read

    with _whole(out) as folder:
        n = write(folder, task, frames())
        if won and options.replays:
            contents["played again"] = _play(task, won, options.replays)
        problem = write_card(
            folder, task, dataset, kept, layout=options.format, licence=options.license, contents=contents,
            command=options.command, observations=observations,
        )  # fmt: skip
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    if problem:
        print(f"no contact sheet: {problem}")
    if "played again" in contents:
        print(contents["played again"])
    print(f"{n} demonstrations, {sum(e.steps for e in kept)} steps, {size / 1e6:.1f} MB: {out}")
    return 0


class Played(NamedTuple):
    """Actions of a success, and the start that they belong to."""

    layout: ActionLayout
    condition: Condition
    actions: Floats


def _play(task: Task, won: list[Played], n: int) -> str:
    """Give the actions of a sample of the successes to the env that the export names, and tell how many succeed."""
    sample = [won[k] for k in np.unique(np.linspace(0, len(won) - 1, n).round().astype(int))]
    bridge = ExportBridge(task, sample[0].layout)
    try:
        share = [acts_again(bridge, each.condition, each.actions) for each in tqdm(sample, leave=False, unit="replay")]
    finally:
        bridge.close()
    env = env_of(task)
    return f"given to {env}, the actions of {sum(share)} of {len(sample)} sampled successes succeed again"


def _contents(task: Task, episode: Frames, layout: str) -> dict[str, str]:
    """Say what each step holds, for the card."""
    seen = [*episode.images, *(f"depth of {camera}" for camera in episode.depths)]
    seen += ["points"] if episode.points is not None and layout != "lerobot" else []
    arguments = ", ".join(f"{name}={value!r}" for name, value in episode.layout.env_arguments.items())
    return {
        "actions": ", ".join(episode.action_names),
        "env of the actions": f"`gymnasium.make({env_of(task)!r}, {arguments})`",
        "observations": ", ".join(["state of the robot", *seen]),
        "privileged": ", ".join(episode.objects) if episode.privileged else "nothing: no truth about objects",
    }


@contextlib.contextmanager
def _whole(out: Path) -> Iterator[Path]:
    """Give a hidden folder that becomes `out` at the end; whatever ends the work early leaves nothing behind."""
    missing = [folder for folder in out.absolute().parents if not folder.exists()]
    temporary = out.with_name(f".{out.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)  # of an export that was killed
    temporary.mkdir(parents=True)
    try:
        yield temporary
        os.replace(temporary, out)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        with contextlib.suppress(OSError):  # someone else's by now
            for folder in missing:
                folder.rmdir()
        raise


def _observations(options: argparse.Namespace, dataset: DemonstrationDataset) -> ObservationFolder | None:
    """Open the rendered observations, as far as the format has a place for them."""
    path = options.observations or options.folder / FOLDER
    if options.no_observations or (options.observations is None and not path.is_dir()):
        return None
    folder = ObservationFolder(path)
    if options.format == "minari" or (options.format == "lerobot" and not folder.settings.images):
        held = "neither pictures nor points" if options.format == "minari" else "no points"
        if options.observations is not None:
            raise ValueError(f"Format {options.format} holds {held}; leave --observations out.")
        return None
    if missing := folder.missing(dataset.ids()):
        raise FileNotFoundError(
            f"{path} lacks {len(missing)} of {len(dataset.ids())} episodes. `dynaforge render` as before adds them."
        )
    return folder
