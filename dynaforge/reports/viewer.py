"""One self-contained page to look through a dataset: clips, joint and action plots with phases and contact."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Attempt, Episode, atomic_write
from dynaforge.demos.observations import ObservationRenderer, ObservationSettings, standard_cameras
from dynaforge.reports.html import render
from dynaforge.reports.video import encode_mp4
from dynaforge.reports.viewer_template import VIEWER
from dynaforge.tasks import Task

SIZE = (320, 240)  # pixels of a clip
STRATA = 8
PLOTS = (
    ("end effector, m", "ee_position", ("x", "y", "z")),
    ("joints, rad", "q", tuple(f"joint {k}" for k in range(1, 8))),
    ("joint speeds, rad/s", "dq", tuple(f"joint {k}" for k in range(1, 8))),
    ("gripper, m", ("width", "width_reference"), ("measured", "asked for")),
    ("residual as applied, m and rad", "residual_action", ("x", "y", "z", "rot x", "rot y", "rot z", "width")),
    ("planned position, m", "planner_action", ("x", "y", "z")),
)


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A recording on the page.

    Attributes:
        episode: Which.
        clip: MP4 bytes, or None.
        scenes: Files of it in three dimensions, relative to the page, by what the link says.
    """

    episode: Episode
    clip: bytes | None = None
    scenes: Mapping[str, str] = field(default_factory=dict)


class Filmer:
    """Makes the clip of an episode from its replay.

    Args:
        task: The task.
    """

    def __init__(self, task: Task) -> None:
        camera = replace(standard_cameras(task)["front"], size=SIZE)
        self._renderer = ObservationRenderer(task, ObservationSettings((camera,)))
        self._fps = task.scene.fps

    def film(self, episode: Episode) -> bytes:
        """Return it as MP4, one picture a control step.

        Raises:
            ValueError: The episode cannot be simulated again.
        """
        return encode_mp4(self._renderer.render(episode)["front/rgb"], fps=self._fps, quality=28)

    def close(self) -> None:
        """Release physics."""
        self._renderer.close()


def write_viewer(
    path: Path, task: Task, attempts: Sequence[Attempt], episodes: Iterable[Shown], *, title: str
) -> None:  # fmt: skip
    """Write the page, whole or not at all.

    Args:
        path: Where.
        task: The task.
        attempts: All of them; those without a recording are listed with their reason.
        episodes: Recordings to show.
        title: Headline.
    """
    rows: dict[str, dict[str, Any]] = {
        a.id: {
            "id": a.id, "ok": a.success, "failure": a.failure, "difficulty": round(a.difficulty, 4),
            "stratum": task.conditions.stratum(a.difficulty, STRATA), "generator": a.generator, "phase": a.phase,
            "duration": round(a.duration, 2),
        }
        for a in attempts
    }  # fmt: skip
    for shown in episodes:
        if shown.episode.id in rows and len(shown.episode):
            rows[shown.episode.id] |= _recording(shown)
    listed = sorted(rows.values(), key=lambda row: ("time" not in row, row["difficulty"]))
    # "</" inside a string would end the script element
    data = json.dumps(listed, allow_nan=False).replace("</", "<\\/")
    text = render(VIEWER, title=title, task=task, n=len(listed), strata=STRATA)
    atomic_write(path, text.replace("/*DATA*/null", data).encode())


def _recording(shown: Shown) -> dict[str, Any]:
    episode, clip = shown.episode, shown.clip
    steps = episode.steps
    plots = []
    for title, names, labels in PLOTS:
        columns = [steps[name] for name in ((names,) if isinstance(names, str) else names) if name in steps]
        if columns:
            table = np.column_stack([c.reshape(len(c), -1) for c in columns])[:, : len(labels)]
            plots.append({"title": title, "labels": labels[: table.shape[1]], "lines": _rounded(table.T)})
    for key in steps:
        if key.startswith(("object/", "fixture/")) and key.endswith("/position"):
            name = key.split("/")[1]
            plots.append({"title": f"{name}, m", "labels": ("x", "y", "z"), "lines": _rounded(steps[key].T)})
    phases = steps["phase"] if "phase" in steps else np.zeros(len(episode), dtype=int)
    starts = np.flatnonzero(np.diff(phases, prepend=phases[0] - 1))
    phase_names = list(episode.meta.get("phases", []))
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
        "contact": episode.meta.get("contact_time"),
        "planned": episode.meta.get("planned_contact_time"),
        "values": {name: round(value, 4) for name, value in episode.condition.values.items()},
        "scenes": dict(shown.scenes),
        "clip": base64.b64encode(clip).decode() if clip else None,
    }


def _rounded(array: NDArray[Any]) -> Any:
    return np.round(np.asarray(array, dtype=float), 4).tolist()
