"""Exporting a dataset: the files of a format, a card beside them, and some actions replayed in the task's env."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.exporters import Frames, exporter
from dynaforge.demos.exporters.frames import Floats, env_arguments_of, env_of
from dynaforge.demos.observations import ObservationFolder
from dynaforge.demos.prescription import FREE
from dynaforge.generators.bridge import ExportBridge, succeeds_again
from dynaforge.reports.card import Exported, write_card
from dynaforge.sim import Condition
from dynaforge.tasks import Task
from dynaforge.tasks.action import ActionLayout


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """How a dataset is exported.

    Attributes:
        layout: Name of the format.
        licence: SPDX identifier for the card.
        command: The command that made the export, for the card.
        replays: How many successes to replay in the task's env, to check that they succeed again.
        observations: Rendered observations for the card's pictures; None simulates a few episodes again.
    """

    layout: str
    licence: str
    command: str
    replays: int = 0
    observations: ObservationFolder | None = None


class ExportResult(NamedTuple):
    """What an export contains.

    Attributes:
        demonstrations: Number of demonstrations.
        steps: Number of control steps in all of them.
        replayed: How many of the sampled successes succeed again, as a sentence; "" if none were sampled.
        no_sheet: Why the card has no contact sheet; "" if it has one.
    """

    demonstrations: int
    steps: int
    replayed: str
    no_sheet: str


def export_dataset(
    dataset: DemonstrationDataset, task: Task, frames: Iterable[Frames], out: Path, options: ExportOptions
) -> ExportResult:
    """Write an export, whole or not at all.

    Args:
        dataset: The dataset to export.
        task: Its task.
        frames: Its episodes, as `read_frames` returns them.
        out: The folder to make.
        options: How to export it.

    Raises:
        FileExistsError: Something is at `out`.
        ValueError: No such format, or an episode that does not fit it.
        ImportError: A library of the `[data]` extra is missing.
    """
    write = exporter(options.layout)
    if out.exists():
        raise FileExistsError(f"{out} exists already. Choose another --out, or remove it.")
    notes = _Notes(task=task, layout=options.layout)
    with _whole_or_nothing(out) as folder:
        n = write(folder, task, notes.taken_on(frames))
        replayed = _replay(task, notes.successes, options.replays) if notes.successes and options.replays else ""
        no_sheet = write_card(
            folder,
            task,
            dataset,
            notes.exported,
            layout=options.layout,
            licence=options.licence,
            contents=notes.contents | ({"replayed": replayed} if replayed else {}),
            command=options.command,
            observations=options.observations,
        )
    return ExportResult(n, sum(episode.steps for episode in notes.exported), replayed, no_sheet)


class _SampledSuccess(NamedTuple):
    """The actions of a successful episode, and the condition that they belong to."""

    layout: ActionLayout
    condition: Condition
    actions: Floats


@dataclass(kw_only=True)
class _Notes:
    """What is kept of each episode on its way into the export: a dataset may be larger than memory."""

    task: Task
    layout: str
    exported: list[Exported] = field(default_factory=list)
    successes: list[_SampledSuccess] = field(default_factory=list)
    contents: dict[str, str] = field(default_factory=dict)

    def taken_on(self, frames: Iterable[Frames]) -> Iterator[Frames]:
        """Yield the episodes unchanged, taking notes on each."""
        for episode in frames:
            self.exported.append(Exported.of(episode.episode))
            self.contents.update(_contents(self.task, episode, self.layout))
            # In the env of its actions, nothing would drive an object whose motion was prescribed.
            if episode.success and episode.episode.dynamics == FREE:
                self.successes.append(_SampledSuccess(episode.layout, episode.episode.condition, episode.actions))
            yield episode
            del episode  # otherwise it would stay in memory while the next one is read


def _contents(task: Task, episode: Frames, layout: str) -> dict[str, str]:
    """Return what each control step contains, for the card."""
    rendered = [*episode.images, *(f"depth of {camera}" for camera in episode.depths)]
    rendered += ["points"] if episode.points is not None and layout != "lerobot" else []
    arguments = ", ".join(f"{name}={value!r}" for name, value in env_arguments_of(task, episode.layout).items())
    return {
        "actions": ", ".join(episode.action_names),
        "env of the actions": f"`gymnasium.make({env_of(task)!r}, {arguments})`",
        "observations": ", ".join(["state of the robot", *rendered]),
        "privileged": ", ".join(episode.objects) if episode.privileged else "nothing: no truth about objects",
    }


def _replay(task: Task, successes: Sequence[_SampledSuccess], n: int) -> str:
    """Give the actions of n of the successes to the env that the export names; return how many succeed again."""
    sample = [successes[k] for k in np.unique(np.linspace(0, len(successes) - 1, n).round().astype(int))]
    bridge = ExportBridge(task, sample[0].layout)
    try:
        bar = tqdm(sample, leave=False, unit="replay")
        again = [succeeds_again(bridge, each.condition, each.actions) for each in bar]
    finally:
        bridge.close()
    return f"given to {env_of(task)}, the actions of {sum(again)} of {len(sample)} sampled successes succeed again"


@contextlib.contextmanager
def _whole_or_nothing(out: Path) -> Iterator[Path]:
    """Yield a hidden folder that becomes `out` at the end; if the work ends early, nothing is left behind."""
    missing = [folder for folder in out.absolute().parents if not folder.exists()]
    temporary = out.with_name(f".{out.name}.tmp")
    shutil.rmtree(temporary, ignore_errors=True)  # left behind by an export that was killed
    temporary.mkdir(parents=True)
    try:
        yield temporary
        os.replace(temporary, out)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        with contextlib.suppress(OSError):  # another process may have put something there
            for folder in missing:
                folder.rmdir()
        raise
