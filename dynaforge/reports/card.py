"""The card of an exported dataset: a README that hubs show, and a contact sheet."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Attempt, Episode, atomic_write
from dynaforge.demos.observations import ObservationRenderer, ObservationSettings, standard_cameras
from dynaforge.evaluation import DgrReport
from dynaforge.reports.video import contact_sheet
from dynaforge.tasks import Task

SHEET = "contact.png"
SHOWN, MOMENTS = 4, 4


def write_card(
    folder: Path, task: Task, attempts: Sequence[Attempt], episodes: Sequence[Episode], *, layout: str, command: str,
    licence: str, actions: Sequence[str],
) -> None:  # fmt: skip
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
    """
    shown = [episodes[k] for k in np.linspace(0, len(episodes) - 1, min(SHOWN, len(episodes))).astype(int)]
    pictures, labels = _moments(task, shown)
    atomic_write(folder / SHEET, contact_sheet(pictures, labels, columns=MOMENTS, cell_width=240))
    steps, fps = [len(e) for e in episodes], task.scene.fps
    report = DgrReport.from_attempts(attempts, difficulty_range=task.conditions.difficulty_range, label=task.env_name)
    generators = Counter(f"{e.generator} {e.meta.get('policy_hash', '')}".strip() for e in episodes)
    won = f"{sum(a.success for a in attempts)} of {len(attempts)} attempts; failures are not hidden"
    versions = {json.dumps(e.meta.get("versions", {}), sort_keys=True) for e in episodes}
    text = f"""---
license: {licence.lower()}
task_categories: [robotics]
tags: [dynaforge, {task.name}, simulation{", LeRobot" if layout == "lerobot" else ""}]
---

# {task.env_name}: {len(episodes)} demonstrations of dynamic manipulation

![contact sheet]({SHEET})

{task.motion} {task.goal}

| | |
|---|---|
| demonstrations | {len(episodes)}, {sum(steps)} control steps at {fps} Hz ({min(steps)} to {max(steps)} each) |
| robot | simulated Franka arm and hand (PyBullet), from the ready pose |
| skill | {task.skill} |
| randomised | {task.randomisation} |
| made by | {", ".join(f"{name} ({n})" for name, n in generators.most_common())} |
| success rate of the generator | {won} |
| actions | {", ".join(actions)} |
| format | {layout} |
| licence | {licence} |
| versions | {"; ".join(sorted(versions))} |

Made with

```
{command}
```

```
{report.table()}
```
"""
    atomic_write(folder / "README.md", text.encode())


def _moments(task: Task, episodes: Sequence[Episode]) -> tuple[list[NDArray[np.uint8]], list[str]]:
    """Draw a few moments of each episode, from beginning to end."""
    camera = replace(standard_cameras(task)["front"], size=(240, 180))
    renderer = ObservationRenderer(task, ObservationSettings((camera,)))
    pictures, labels = [], []
    try:
        for episode in episodes:
            film = renderer.render(episode)["front/rgb"]
            for k in np.linspace(0, len(film) - 1, MOMENTS).astype(int).tolist():
                pictures.append(film[k])
                labels.append(f"{episode.condition.difficulty:.2f}, {episode.steps['time'][k]:.1f} s")
    finally:
        renderer.close()
    return pictures, labels
