"""The card of an exported dataset: a README that hubs show, and a contact sheet."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Attempt, DemonstrationDataset, Episode
from dynaforge.demos.observations import ObservationFolder, ObservationRenderer, ObservationSettings, standard_cameras
from dynaforge.evaluation import DgrReport
from dynaforge.files.atomic import atomic_write
from dynaforge.reports.video import contact_sheet
from dynaforge.tasks import Task

SHEET = "contact.png"
SHOWN, MOMENTS = 4, 4


@dataclass(frozen=True, slots=True)
class Exported:
    """What a card tells of an episode: episodes themselves are too large to be kept until it is written.

    Attributes:
        id: Of the episode.
        steps: Control steps.
        made_by: Generator, and digest of its policy.
        versions: Of the packages that it was recorded with, JSON.
    """

    id: str
    steps: int
    made_by: str
    versions: str

    @staticmethod
    def of(episode: Episode) -> Exported:
        """Note an episode."""
        made_by = " ".join(f"{episode.generator} {episode.meta.get('policy_hash', '')}".split())
        return Exported(episode.id, len(episode), made_by, json.dumps(episode.meta.get("versions", {}), sort_keys=True))


def write_card(
    folder: Path,
    task: Task,
    dataset: DemonstrationDataset,
    episodes: Sequence[Exported],
    *,
    layout: str,
    command: str,
    licence: str,
    contents: Mapping[str, str],
    observations: ObservationFolder | None = None,
) -> str:
    """Write `README.md` and `contact.png` into an exported dataset.

    Args:
        folder: The export.
        task: The task.
        dataset: What it was made from; the card counts all its attempts, failures too.
        episodes: What it contains.
        layout: Name of the format.
        command: What made it.
        licence: An SPDX identifier.
        contents: More rows of the table, e.g. the names of the components of an action.
        observations: Rendered pictures, for the contact sheet; without any the episodes shown are simulated again.

    Returns:
        Why there is no contact sheet; "" if there is one.
    """
    middle = np.linspace(0, len(episodes) - 1, min(SHOWN, len(episodes))).astype(int)
    shown = [dataset[episodes[k].id] for k in middle]
    attempts = dataset.attempts()
    try:
        pictures, labels = _moments(task, shown, observations)
        atomic_write(folder / SHEET, contact_sheet(pictures, labels, columns=MOMENTS, cell_width=240))
        problem = ""
    except ValueError as error:
        problem = str(error)
    steps, fps = [e.steps for e in episodes], task.scene.fps
    reports = [_report(task, attempts, name) for name in sorted({attempt.generator for attempt in attempts})]
    generators = Counter(e.made_by for e in episodes)
    won = ", ".join(f"{report.label}: {report.total.successes} of {report.n} attempts" for report in reports)
    versions = {e.versions for e in episodes}
    more = "".join(f"| {name} | {value} |\n" for name, value in contents.items())
    text = f"""---
license: {licence.lower()}
task_categories: [robotics]
tags: [dynaforge, {task.name}, simulation{", LeRobot" if layout == "lerobot" else ""}]
---

# {task.env_name}: {len(episodes)} demonstrations of dynamic manipulation

{"" if problem else f"![contact sheet]({SHEET})"}

{task.motion} {task.goal}

| | |
|---|---|
| demonstrations | {len(episodes)}, {sum(steps)} control steps at {fps} Hz ({min(steps)} to {max(steps)} each) |
| robot | simulated Franka arm and hand (PyBullet), from the ready pose |
| skill | {task.skill} |
| instruction | {task.instruction} |
| randomised | {task.randomisation} |
| made by | {", ".join(f"{name} ({n})" for name, n in generators.most_common())} |
| successes | {won}; failures are not hidden |
{more}| format | {layout} |
| licence | {licence} |
| versions | {"; ".join(sorted(versions))} |

Made with

```
{command}
```

```
{chr(10).join(report.table() for report in reports)}
```
"""
    atomic_write(folder / "README.md", text.encode())
    return problem


def _report(task: Task, attempts: Sequence[Attempt], generator: str) -> DgrReport:
    made = [attempt for attempt in attempts if attempt.generator == generator]
    return DgrReport.from_attempts(made, difficulty_range=task.conditions.difficulty_range, label=generator)


def _moments(
    task: Task, episodes: Sequence[Episode], observations: ObservationFolder | None
) -> tuple[list[NDArray[np.uint8]], list[str]]:
    """Show a few moments of each episode, from beginning to end.

    Raises:
        ValueError: An episode was not rendered and cannot be simulated again.
    """
    pictures, labels = [], []
    for episode, film in zip(episodes, _films(task, episodes, observations), strict=True):
        for k in np.linspace(0, len(film) - 1, MOMENTS).astype(int).tolist():
            pictures.append(film[k])
            labels.append(f"{episode.condition.difficulty:.2f}, {episode.steps['time'][k]:.1f} s")
    return pictures, labels


def _films(
    task: Task, episodes: Sequence[Episode], observations: ObservationFolder | None
) -> Iterator[NDArray[np.uint8]]:
    if observations is not None and observations.settings.images:
        first = f"{observations.settings.cameras[0].name}/rgb"
        yield from (observations.of(episode)[first] for episode in episodes)
        return
    camera = replace(standard_cameras(task)["front"], size=(240, 180))
    renderer = ObservationRenderer(task, ObservationSettings((camera,)))
    try:
        yield from (renderer.render(episode)["front/rgb"] for episode in episodes)
    finally:
        renderer.close()
