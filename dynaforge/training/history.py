"""What a training run leaves behind, one row per update: the same for every algorithm, so that runs compare."""

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
    """Success without exploration in the midst of training, one condition a stratum.

    Attributes:
        update: Updates made before it.
        timesteps: Environment steps made before it.
        success: Of each stratum, shape (S,).
    """

    update: int
    timesteps: int
    success: list[bool]


@dataclass(slots=True)
class TrainingHistory:
    """A training run, update by update; U updates, S equal strata of difficulty.

    Attributes:
        successes: Exploring episodes that ended in success, by the stratum of their condition, shape (U, S).
        trials: Exploring episodes that ended, shape (U, S); 0 where sampling left a stratum out.
        groups: Groups that failed throughout, were mixed, succeeded throughout, shape (U, 3); empty without groups.
        timesteps: Environment steps since the start, shape (U,), as are the following.
        optimizer_steps: Steps of the optimizer since the start.
        transitions_used: Gated transitions of kept groups since the start, each counted once an update.
        collect_wall, collect_cpu: Seconds that the update's episodes took; CPU of this process.
        optimize_wall, optimize_cpu: Seconds that its optimisation took.
        probes: Measurements without exploration.
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
        """Mean over the strata that had trials, of each update, shape (U,)."""
        return self.frontier().overall

    def frontier(self) -> FrontierAnalysis:
        """Analyse how deep the mastered strata reach."""
        return analyse_frontier(self.successes, np.array(self.trials))

    def up_to(self, timesteps: int) -> TrainingHistory:
        """Return the part within so many environment steps: what a checkpoint of that moment knows."""
        n = int(np.searchsorted(self.timesteps, timesteps, side="right"))
        rows = {f.name: getattr(self, f.name)[:n] for f in fields(self) if f.name != "probes"}
        return TrainingHistory(**rows, probes=[probe for probe in self.probes if probe.timesteps <= timesteps])

    def save(self, path: Path) -> None:
        """Write it as JSON, as a whole or not at all."""
        atomic_write(path, json.dumps(asdict(self)).encode())

    @staticmethod
    def load(path: Path) -> TrainingHistory:
        """Read what `save` wrote.

        Raises:
            ValueError: The file is something else.
        """
        try:
            return TrainingHistory.of(json.loads(path.read_text()))
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path} is no training history: {error}.") from error

    @staticmethod
    def of(data: Any) -> TrainingHistory:
        """Make it of the JSON data of a file.

        Raises:
            ValueError: The data are something else.
        """
        try:
            history = TrainingHistory(**data | {"probes": [Probe(**probe) for probe in data["probes"]]})
            for f in fields(history):
                _check_numbers(f.name, getattr(history, f.name))
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(str(error)) from error
        return history


def _check_numbers(name: str, rows: Any) -> None:
    """Refuse what is no list of finite numbers, of lists of them, or of probes made of them."""
    if not isinstance(rows, list):
        raise ValueError(f"{name} is no list")
    for row in rows:
        parts = [row.update, row.timesteps, *row.success] if isinstance(row, Probe) else row
        for number in parts if isinstance(parts, list) else [parts]:
            if not isinstance(number, (int, float)) or not math.isfinite(number):
                raise ValueError(f"{name} holds {number!r:.40}, no finite number")
