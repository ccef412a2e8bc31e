"""A finished training run, read back from its folder or from the archive of its task."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.geometry import one_line
from dynaforge.training.history import TrainingHistory
from dynaforge.training.run_archive import EVALUATED, read_run
from dynaforge.training.run_spec import OLDER_PHYSICS, PLANNER_ONLY, Evaluation, setting_in_words


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StoredRun:
    """A finished run.

    Attributes:
        task: Name of the task.
        variant: Name of the variant; `PLANNER_ONLY` was not trained.
        seed: Training seed.
        settings: Hyperparameters of the training; empty for the planner.
        history: History of the training; None for the planner.
        success: Success of the final policy on each condition of its evaluation, shape (C,).
        conditions: Ids of these conditions.
        failures: Reason of each failed attempt.
        evaluation: Stream and blocks that the conditions were taken from.
        definition: Digest of the task's definition, its setting included; "" for one of the older physics.
        setting: The setting of the task, in words.
    """

    task: str
    variant: str
    seed: int
    settings: dict[str, Any]
    history: TrainingHistory | None
    success: NDArray[np.bool_]
    conditions: tuple[str, ...]
    failures: tuple[str, ...]
    evaluation: Evaluation
    definition: str = ""
    setting: str = OLDER_PHYSICS

    __repr__ = one_line

    @staticmethod
    def load(folder: Path) -> StoredRun:
        """Read a run from its folder or, where that is gone, from the archive of its task.

        Raises:
            ValueError: A file is damaged.
        """
        try:
            files = read_run(folder)
            evaluated, metadata = files[EVALUATED], files.get("run.json")
            outcomes = [attempt["outcome"] for attempt in evaluated["attempts"]]
            return StoredRun(
                task=evaluated["task"],
                variant=metadata["run"]["arm"] if metadata else PLANNER_ONLY,
                seed=metadata["run"]["seed"] if metadata else 0,
                settings=metadata["settings"] if metadata else {},
                history=TrainingHistory.of(files["history.json"]) if metadata else None,
                success=np.array([outcome == "success" for outcome in outcomes]),
                conditions=tuple(attempt["id"] for attempt in evaluated["attempts"]),
                failures=tuple(outcome for outcome in outcomes if outcome != "success"),
                evaluation=Evaluation(**evaluated["exam"]),
                definition=evaluated.get("task_definition", ""),
                setting=setting_in_words(evaluated.get("setting")),
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{folder} holds no readable run: {type(error).__name__}: {error}.") from error

    @property
    def rate(self) -> float:
        """Demonstration generation rate: the share of attempts that succeeded."""
        return float(self.success.mean())
