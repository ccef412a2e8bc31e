"""The card of an exported dataset: a README that hubs show, and a contact sheet."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Attempt, Episode, atomic_write
from dynaforge.demos.observations import ObservationFolder, ObservationRenderer, ObservationSettings, standard_cameras
from dynaforge.evaluation import DgrReport
from dynaforge.reports.video import contact_sheet
from dynaforge.tasks import Task

SHEET = "contact.png"
SHOWN, MOMENTS = 4, 4


def write_card(
    folder: Path, task: Task, attempts: Sequence[Attempt], episodes: Sequence[Episode], *, layout: str, command: str,
    licence: str, actions: Sequence[str], observations: ObservationFolder | None = None,
) -> str:  # fmt: skip
    """Write `README.md` and `contact.png` into an exported dataset.

    Args:
        folder: The export.
        task: The task.
        attempts: All attempts behind it, failures too.
        episodes: What it holds.
        layout: Name of the format.
        command: What made it.
        licence: An SPDX identifier.
        actions: Names of the components of an action.
        observations: Rendered pictures, for the contact sheet; without any the episodes shown are simulated again.

    Returns:
        Why there is no contact sheet; "" if there is one.
    """
    shown = [episodes[k] for k in np.linspace(0, len(episodes) - 1, min(SHOWN, len(episodes))).astype(int)]
    try:
        pictures, labels = _moments(task, shown, observations)
        atomic_write(folder / SHEET, contact_sheet(pictures, labels, columns=MOMENTS, cell_width=240))
        problem = ""
    except ValueError as error:
        problem = str(error)
    steps, fps = [len(e) for e in episodes], task.scene.fps
    reports = [_report(task, attempts, name) for name in sorted({attempt.generator for attempt in attempts})]
    generators = Counter(f"{e.generator} {e.meta.get('policy_hash', '')}".strip() for e in episodes)
    won = ", ".join(f"{report.label}: {report.total.successes} of {report.n} attempts" for report in reports)
    versions = {json.dumps(e.meta.get("versions", {}), sort_keys=True) for e in episodes}
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
| randomised | {task.randomisation} |
| made by | {", ".join(f"{name} ({n})" for name, n in generators.most_common())} |
| successes | {won}; failures are not hidden |
| actions | {", ".join(actions)} |
| format | {layout} |
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
