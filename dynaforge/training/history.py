"""The history of a training run, one row per update, in one format for all algorithms so that they can be compared."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from dynaforge.evaluation.frontier import FrontierAnalysis, analyse_frontier
from dynaforge.files.atomic import atomic_write
from dynaforge.geometry import Array, one_line

STRATA = 16


@dataclass(slots=True)
class Probe:
    """Success without exploration at one moment of training, on one condition per stratum.

    Attributes:
        update: Updates made before it.
        timesteps: Environment steps made before it.
        success: Whether each stratum's attempt succeeded, shape (S,).
    """

    update: int
    timesteps: int
    success: list[bool]


@dataclass(slots=True, kw_only=True)
class TrainingHistory:
    """A training run, update by update: U updates, S equal strata of difficulty.

    Attributes:
        successes: Rollouts that succeeded, by the stratum of their condition, shape (U, S).
        trials: Rollouts that ended, shape (U, S); 0 where sampling left a stratum out.
        groups: Numbers of groups that all failed, were mixed, all succeeded, shape (U, 3); empty without groups.
        timesteps: Environment steps since the start, shape (U,), as are the following.
        optimizer_steps: Optimizer steps since the start.
        transitions_used: Gated transitions of kept groups since the start, each counted once per update.
        collect_wall, collect_cpu: Seconds that the update's rollouts took; CPU is that of all processes.
        optimize_wall, optimize_cpu: Seconds that its optimisation took.
        probes: Success without exploration, as measured during training.
    """

    successes: list[list[int]] = field(default_factory=list)
    trials: list[list[int]] = field(default_factory=list)
    groups: list[list[int]] = field(default_factory=list)
    timesteps: list[int] = field(default_factory=list)
    optimizer_steps: list[int] = field(default_factory=list)
    transitions_used: list[int] = field(default_factory=list)
    collect_wall: list[float] = field(default_factory=list)
    collect_cpu: list[float] = field(default_factory=list)
    optimize_wall: list[float] = field(default_factory=list)
    optimize_cpu: list[float] = field(default_factory=list)
    probes: list[Probe] = field(default_factory=list)

    __repr__ = one_line

    def __len__(self) -> int:
        """Number of updates."""
        return len(self.timesteps)

    @property
    def success(self) -> Array:
        """Success of each update, mean over strata, see `FrontierAnalysis.overall`, shape (U,)."""
        return self.frontier().overall

    def frontier(self) -> FrontierAnalysis:
        """Analyse which strata are mastered at each update."""
        return analyse_frontier(self.successes, np.array(self.trials))

    def up_to(self, timesteps: int) -> TrainingHistory:
        """Return the part within a number of environment steps: what a training checkpoint of that moment contains."""
        n = int(np.searchsorted(self.timesteps, timesteps, side="right"))
        rows = {f.name: getattr(self, f.name)[:n] for f in fields(self) if f.name != "probes"}
        return TrainingHistory(**rows, probes=[probe for probe in self.probes if probe.timesteps <= timesteps])

    def save(self, path: Path) -> None:
        """Write the history as JSON, whole or not at all."""
        atomic_write(path, json.dumps(asdict(self)).encode())

    @staticmethod
    def load(path: Path) -> TrainingHistory:
        """Read what `save` wrote.

        Raises:
            ValueError: The file is not a training history.
        """
        try:
            return TrainingHistory.of(json.loads(path.read_text()))
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path} is not a training history: {error}.") from error

    @staticmethod
    def of(data: Any) -> TrainingHistory:
        """Build a history from the JSON data of a file.

        Raises:
            ValueError: The data are not those of a training history.
        """
        try:
            history = TrainingHistory(**data | {"probes": [Probe(**probe) for probe in data["probes"]]})
            for f in fields(history):
                _check_numbers(f.name, getattr(history, f.name))
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(str(error)) from error
        return history


def _check_numbers(name: str, rows: Any) -> None:
    """Refuse anything but a list of finite numbers, of lists of them, or of probes made of them."""
    if not isinstance(rows, list):
        raise ValueError(f"{name} is not a list")
    for row in rows:
        parts = [row.update, row.timesteps, *row.success] if isinstance(row, Probe) else row
        for number in parts if isinstance(parts, list) else [parts]:
            if not isinstance(number, (int, float)) or not math.isfinite(number):
                raise ValueError(f"{name} contains {number!r:.40}, which is not a finite number")
