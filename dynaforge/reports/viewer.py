"""One self-contained page to browse a dataset: clips, and plots of joints and actions with phases and contact."""

from __future__ import annotations

import base64
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Attempt, Episode
from dynaforge.files.atomic import atomic_write
from dynaforge.reports.html import render, script_data
from dynaforge.reports.viewer_clips import FRAME_STEPS, ViewerEpisode
from dynaforge.reports.viewer_summary import STRATA, strata, summarise
from dynaforge.reports.viewer_template import VIEWER
from dynaforge.tasks import Task

PLOTS = (  # title, columns of the recording, labels of the lines
    ("end effector, m", ("ee_position",), ("x", "y", "z")),
    ("joints, rad", ("q",), tuple(f"joint {k}" for k in range(1, 8))),
    ("joint speeds, rad/s", ("dq",), tuple(f"joint {k}" for k in range(1, 8))),
    ("gripper, m", ("width", "width_reference"), ("measured", "commanded")),
    ("residual as applied, m and rad", ("residual_action",), ("x", "y", "z", "rot x", "rot y", "rot z", "width")),
    ("planned position, m", ("planner_action",), ("x", "y", "z")),
)


def write_viewer(
    path: Path,
    task: Task,
    attempts: Sequence[Attempt],
    episodes: Iterable[ViewerEpisode],
    *,
    title: str,
    recorded: Collection[str] = (),
) -> None:
    """Write the page, whole or not at all.

    Args:
        path: The page's file.
        task: The task.
        attempts: All attempts of the dataset; those without a recording are listed with their reason.
        episodes: Recordings to show.
        title: Headline.
        recorded: Ids of all recordings of the dataset, shown or not.
    """
    easiest_first = sorted(attempts, key=lambda attempt: attempt.difficulty)
    rows = {attempt.id: _row(task, attempt, recorded) for attempt in easiest_first}
    for viewed in episodes:
        if viewed.id in rows:
            rows[viewed.id] |= {"note": viewed.note}
            if viewed.episode is not None and len(viewed.episode):
                rows[viewed.id] |= _recording(viewed, viewed.episode)
    listed = sorted(rows.values(), key=lambda row: "time" not in row)
    unit = task.conditions.units.get(task.conditions.difficulty, "")
    page = {
        "title": title,
        "task": task.name,
        "unit": unit,
        "phases": task.n_checkpoints,
        "picture": FRAME_STEPS * task.scene.control_dt,
        "summary": summarise(task, attempts),
    }
    generators = sorted({attempt.generator for attempt in attempts})
    text = render(
        VIEWER,
        title=title,
        task=task,
        n=len(listed),
        strata=strata(task),
        generators=generators,
        page=script_data(page),
        episodes=script_data(listed),
    )
    atomic_write(path, text.encode(errors="replace"))  # the name of a folder may contain bytes that are not text


def _row(task: Task, attempt: Attempt, recorded: Collection[str]) -> dict[str, Any]:
    """Return an attempt as the page lists it."""
    units, outcome = task.conditions.units, attempt.outcome
    return {
        "id": attempt.id,
        "ok": outcome.success,
        "failure": outcome.failure,
        "difficulty": _figures(attempt.difficulty),
        "stratum": task.conditions.stratum(attempt.difficulty, STRATA),
        "generator": attempt.generator,
        "phase": outcome.phase,
        "checkpoint": outcome.checkpoint,
        "duration": round(attempt.duration, 2),
        "values": [
            [name, _figures(value), units.get(name, "")] for name, value in sorted(attempt.condition.values.items())
        ],
        "note": _why_not_shown(task, attempt, recorded),
    }


def _why_not_shown(task: Task, attempt: Attempt, recorded: Collection[str]) -> str:
    """Return why an attempt's recording is not on the page, in sentences."""
    if attempt.id in recorded:
        return (
            "Its recording is in the folder, but this page shows a selection. "
            f"`dynaforge view --limit {len(recorded)}` makes a page of all recordings."
        )
    if attempt.success or attempt.recorded:
        return "Its recording was kept, but it is gone from the folder. `dynaforge collect`, as before, makes it again."
    if not attempt.outcome.phase:
        return "This attempt ended before there was anything to record."
    return (
        "The recording of this failure was not kept, since `dynaforge collect` keeps those of successes only. "
        f"`dynaforge collect --task {task.name} --keep-failures --out NEW_FOLDER` attempts the same conditions "
        "and keeps failures too."
    )


def _recording(viewed: ViewerEpisode, episode: Episode) -> dict[str, Any]:
    """Return a recording as the page shows it: plots, phases, contact times and films."""
    steps = episode.steps
    plots = []
    for title, names, labels in PLOTS:
        columns = [steps[name] for name in names if name in steps]
        if columns:
            table = np.column_stack([column.reshape(len(column), -1) for column in columns])[:, : len(labels)]
            plots.append({"title": title, "labels": labels[: table.shape[1]], "lines": _rounded(table.T)})
    for key in steps:
        if key.startswith(("object/", "fixture/")) and key.endswith("/position"):
            name = key.split("/")[1]
            plots.append({"title": f"{name}, m", "labels": ("x", "y", "z"), "lines": _rounded(steps[key].T)})
    phases = steps["phase"] if "phase" in steps else np.zeros(len(episode), dtype=int)
    starts = np.flatnonzero(np.diff(phases, prepend=phases[0] - 1))
    phase_names = [str(name) for name in episode.meta.get("phases", [])]
    return {
        "time": _rounded(steps["time"]),
        "plots": plots,
        "phases": [
            {
                "name": phase_names[phases[k]] if phases[k] < len(phase_names) else str(phases[k]),
                "from": float(steps["time"][k]),
            }
            for k in starts.tolist()
        ],
        "contact": _time(episode.meta.get("contact_time")),
        "planned": _time(episode.meta.get("planned_contact_time")),
        "scenes": dict(viewed.scenes),
        "clip": base64.b64encode(viewed.clip).decode() if viewed.clip else None,
        "views": [[name, base64.b64encode(film).decode()] for name, film in viewed.views.items()],
    }


def _figures(value: float) -> float:
    """Round to three significant digits: the fields of a user-defined task may have any magnitude."""
    return float(f"{value:.3g}")


def _time(noted: object) -> float | None:
    return float(noted) if isinstance(noted, int | float) else None


def _rounded(array: NDArray[Any]) -> Any:
    return np.round(np.asarray(array, dtype=float), 4).tolist()
