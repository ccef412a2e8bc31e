"""What training a residual policy cost, read from the folder that `dynaforge compare` or `dynaforge forge` left."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

from dynaforge.sim.setting import Setting
from dynaforge.tasks import Task
from dynaforge.tasks.digest import task_digest
from dynaforge.training.forge_folder import REQUEST
from dynaforge.training.history import TrainingHistory
from dynaforge.training.run_archive import ARCHIVE, EVALUATED, read_archive, read_run
from dynaforge.training.stored_training import HISTORY

TRAINED = "trained.json"
"""The stage of `forge` that says that the training is finished."""


@dataclass(frozen=True, slots=True)
class TrainingCost:
    """The trainings of a task with one algorithm.

    Attributes:
        variant: Name of the variant of `compare`, or of the algorithm of `forge`.
        hours: CPU-hours of each training: its rollouts and optimisation, without what probes and evaluates the policy.
    """

    variant: str
    hours: tuple[float, ...]

    @property
    def mean(self) -> float:
        """CPU-hours of one training, mean over the training seeds."""
        return mean(self.hours)


def training_cost(folder: Path, task: Task, *, variant: str | None = None) -> TrainingCost:
    """Read what the finished trainings of a task cost.

    Args:
        folder: The folder of `compare`, with its runs or their archives, or that of a run of `forge`.
        task: The task; a training may have been in another setting of it.
        variant: Which of the variants; None where there is one only.

    Raises:
        ValueError: The folder contains no finished training of the task, or several variants of which none was chosen,
            or trainings of another definition of the task, or a damaged file; the message says which.
    """
    found: dict[str, list[float]] = {}
    for name, made_for, history in _trainings(folder, task.name):
        if variant in (None, name):
            _check_definition(folder, task, made_for)
        found.setdefault(name, []).append((sum(history.collect_cpu) + sum(history.optimize_cpu)) / 3600.0)
    names = ", ".join(sorted(found))
    if not found:
        raise ValueError(f"{folder} holds no finished training of {task.name!r}.")
    if variant is None and len(found) > 1:
        raise ValueError(f"{folder} holds trainings of {task.name!r} by {names}; choose one of these variants.")
    chosen = variant or names
    if chosen not in found:
        raise ValueError(f"{folder} holds no finished training of {task.name!r} by {chosen!r}, but by {names}.")
    return TrainingCost(chosen, tuple(found[chosen]))


def _trainings(folder: Path, task: str) -> Iterator[tuple[str, Mapping[str, Any], TrainingHistory]]:
    """Yield name, what it was made for, and history of every finished training of a task in a folder."""
    try:
        if (folder / REQUEST).is_file():
            request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
            if request["task"] == task and (folder / TRAINED).is_file():
                yield request["algo"], request, TrainingHistory.load(folder / HISTORY)
            return
        for run in _finished_runs(folder / task):
            files = read_run(run)
            made = files["run.json"]["run"]
            yield made["arm"], made, TrainingHistory.of(files[HISTORY])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(
            f"{folder} holds no readable training of {task!r}: {type(error).__name__}: {error}."
        ) from error


def _finished_runs(folder: Path) -> list[Path]:
    """Return the folders of the finished trainings of a task, of which only the archive may be left."""
    kept = [path.parent for path in folder.glob(f"*/seed-*/{EVALUATED}")]
    archived = [folder / key for key in read_archive(folder / ARCHIVE) if "/seed-" in key]
    return sorted({*kept, *archived})


def _check_definition(folder: Path, task: Task, made_for: Mapping[str, Any]) -> None:
    try:
        setting = Setting.from_dict(made_for["setting"])
        same = made_for["task_definition"] == task_digest(task.under(**setting.to_dict()))
    except (KeyError, TypeError, ValueError):  # older physics, or no setting
        same = False
    if not same:
        raise ValueError(f"{folder} holds trainings of another definition of {task.name!r}, which cost something else.")
