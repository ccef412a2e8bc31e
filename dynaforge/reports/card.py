"""The card of an exported dataset: a README that hubs show, and a contact sheet."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import DemonstrationDataset, Episode
from dynaforge.demos.observations import ObservationFolder, ObservationRenderer, ObservationSettings, standard_cameras
from dynaforge.demos.prescription import describe_dynamics
from dynaforge.evaluation import DgrReport
from dynaforge.files.atomic import atomic_write
from dynaforge.reports.evaluation import by_generator, reports_of
from dynaforge.reports.forces import describe_peaks, describe_reflex
from dynaforge.reports.video import contact_sheet
from dynaforge.sim.loads import Loads
from dynaforge.tasks import Task

SHEET = "contact.png"
CARD = """---
license: {licence}
task_categories: [robotics]
tags: [{tags}]
---

# {title}

{picture}

{description}

| | |
|---|---|
{table}

Made with

```
{command}
```

```
{rates}
```
"""
SHEET_EPISODES, SHEET_MOMENTS = 4, 4  # rows and columns of the contact sheet


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """What the card says about an episode: episodes themselves are too large to keep until it is written.

    Attributes:
        id: Id of the episode.
        steps: Number of control steps.
        made_by: Its generator, and the digest of the policy.
        versions: Versions of the packages that it was recorded with, as JSON.
        loads: The greatest loads on the robot; None where they are not known.
        dynamics: What moves the object, as in `AttemptFacts`.
    """

    id: str
    steps: int
    made_by: str
    versions: str
    loads: Loads | None
    dynamics: str

    @staticmethod
    def of(episode: Episode) -> Exported:
        """Take what the card needs from an episode."""
        made_by = " ".join(f"{episode.generator} {episode.meta.get('policy_hash', '')}".split())
        versions = json.dumps(episode.meta.get("versions", {}), sort_keys=True)
        return Exported(
            id=episode.id,
            steps=len(episode),
            made_by=made_by,
            versions=versions,
            loads=episode.loads,
            dynamics=episode.dynamics,
        )


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
        episodes: The episodes that it contains.
        layout: Name of the format.
        command: The command that made it.
        licence: An SPDX identifier.
        contents: More rows of the table, e.g. the names of an action's components.
        observations: Rendered pictures for the contact sheet; None simulates a few episodes again.

    Returns:
        Why there is no contact sheet; "" if there is one.
    """
    problem = _write_sheet(folder / SHEET, task, dataset, episodes, observations)
    reports = reports_of(task, by_generator(dataset.attempts()))
    rows = {
        **_facts(task, episodes, reports),
        **contents,
        "format": layout,
        "licence": licence,
        "versions": "; ".join(sorted({episode.versions for episode in episodes})),
    }
    text = CARD.format(
        licence=licence.lower(),
        tags=f"dynaforge, {task.name}, simulation" + (", LeRobot" if layout == "lerobot" else ""),
        title=f"{task.env_name}: {len(episodes)} demonstrations of dynamic manipulation",
        picture="" if problem else f"![contact sheet]({SHEET})",
        description=f"{task.motion} {task.goal}",
        table="\n".join(f"| {name} | {value} |" for name, value in rows.items()),
        command=command,
        rates="\n".join(report.table() for report in reports),
    )
    atomic_write(folder / "README.md", text.encode())
    return problem


def _facts(task: Task, episodes: Sequence[Exported], reports: Sequence[DgrReport]) -> dict[str, str]:
    """Return the rows of the card's table that describe task and episodes."""
    steps, dynamics = [episode.steps for episode in episodes], describe_dynamics(e.dynamics for e in episodes)
    generators = Counter(episode.made_by for episode in episodes)
    successes = ", ".join(f"{report.label}: {report.total.successes} of {report.n} attempts" for report in reports)
    return {
        "demonstrations": f"{len(episodes)}, {sum(steps)} control steps at {task.scene.fps} Hz "
        f"({min(steps)} to {max(steps)} each)",
        "robot": "simulated Franka arm and hand (PyBullet), from the ready pose",
        "reflex": describe_reflex(task.setting.reflex),
        "peak force": describe_peaks([episode.loads for episode in episodes], task.setting.reflex),
        **({"dynamics": dynamics} if dynamics else {}),
        "hidden physics": task.setting.physics,
        "sensing": task.setting.sensing,
        "skill": task.skill,
        "instruction": task.instruction,
        "randomised": task.randomisation,
        "made by": ", ".join(f"{name} ({n})" for name, n in generators.most_common()),
        "successes": f"{successes}; every attempt is counted",
    }


def _write_sheet(
    path: Path,
    task: Task,
    dataset: DemonstrationDataset,
    episodes: Sequence[Exported],
    observations: ObservationFolder | None,
) -> str:
    """Write the contact sheet; return why there is none, or "" if there is one."""
    rows = np.linspace(0, len(episodes) - 1, min(SHEET_EPISODES, len(episodes))).astype(int)
    try:
        pictures, labels = _moments(task, [dataset[episodes[row].id] for row in rows], observations)
        atomic_write(path, contact_sheet(pictures, labels, columns=SHEET_MOMENTS, cell_width=240))
    except ValueError as error:
        return str(error)
    return ""


def _moments(
    task: Task, episodes: Sequence[Episode], observations: ObservationFolder | None
) -> tuple[list[NDArray[np.uint8]], list[str]]:
    """Return pictures of a few moments of each episode, from beginning to end, with their labels.

    Raises:
        ValueError: An episode was not rendered and cannot be simulated again.
    """
    pictures, labels = [], []
    for episode, film in zip(episodes, _films(task, episodes, observations), strict=True):
        for k in np.linspace(0, len(film) - 1, SHEET_MOMENTS).astype(int).tolist():
            pictures.append(film[k])
            labels.append(f"{episode.condition.difficulty:.2f}, {episode.steps['time'][k]:.1f} s")
    return pictures, labels


def _films(
    task: Task, episodes: Sequence[Episode], observations: ObservationFolder | None
) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures of each episode: those of its first camera, or of the front camera, simulated again."""
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
