"""What the first table shows: generators on tasks, compared on the same conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynaforge.evaluation import DgrReport, PairedDifference, paired_difference
from dynaforge.evaluation.psychometric import PsychometricCurve, fit_curve
from dynaforge.evaluation.rate_table import RateTable
from dynaforge.evaluation.sequential import SequentialComparison, sequential_difference
from dynaforge.generators.measurements import Measurement
from dynaforge.geometry import one_line
from dynaforge.reports.evaluation import BINS
from dynaforge.sim.reflex import named_within
from dynaforge.sim.setting import Setting

PLANNER, RESIDUAL = "planner_only", "residual"

LABELS = {
    "state_machine": "State machine (DynamicVLA)",
    "dmp": "DMP (DynaMimicGen)",
    PLANNER: "Planner only",
    "prediction": "Planner that predicts",
    "grpo": "Residual, vanilla GRPO",
    RESIDUAL: "Residual",
    "replay": "Replay (DOMINO)",
}
"""What the table calls the generators; another generator is called by its name."""

RESAMPLES = 1000


def is_unpaired(row: str) -> bool:
    """Return whether a generator's attempts are compared with no other: replay prescribes the object's motion."""
    return row.partition("-")[0] == "replay"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Table1:
    """All that was measured for the table.

    Attributes:
        tasks: Its columns, in order.
        rows: Its rows, in order.
        measured: Row and task to what was measured.
        refused: Row and task to why the generator does not do the task.
        sequential: Whether comparisons were allowed to end early.
        reports: Row to task to the DGR, of the paired rows and of the others.
        curves: Row and task to success against speed, of the paired rows on the tasks that have a speed.

    Raises:
        ValueError: Measurements of the same task were not made on the same conditions, or not in the same setting.
    """

    tasks: tuple[str, ...]
    rows: tuple[str, ...]
    measured: Mapping[tuple[str, str], Measurement]
    refused: Mapping[tuple[str, str], str]
    sequential: bool = False
    reports: Mapping[str, Mapping[str, DgrReport]] = field(init=False)
    curves: Mapping[tuple[str, str], PsychometricCurve] = field(init=False)

    __repr__ = one_line

    def __post_init__(self) -> None:
        for task in self.tasks:
            self._check_same(task)
        reports: dict[str, dict[str, DgrReport]] = {row: {} for row in self.rows}
        for (row, task), measurement in self.measured.items():
            reports[row][task] = _report(measurement)
        object.__setattr__(self, "reports", reports)
        paired = ((key, found) for key, found in self.measured.items() if not is_unpaired(key[0]))
        curves = {key: curve for key, found in paired if (curve := speed_curve(found)) is not None}
        object.__setattr__(self, "curves", curves)

    @property
    def paired(self) -> tuple[str, ...]:
        """The rows whose attempts are on the same conditions."""
        return tuple(row for row in self.rows if not is_unpaired(row))

    @property
    def unpaired(self) -> tuple[str, ...]:
        """The other rows."""
        return tuple(row for row in self.rows if is_unpaired(row))

    @property
    def reference(self) -> str:
        """The row that the other paired ones are compared with: the residual, or else the first; "" without any."""
        return reference_of(self.paired)

    @property
    def gains(self) -> bool:
        """Whether the table has the paper's row of gains, of the residual over the planner."""
        return {PLANNER, RESIDUAL} <= set(self.rows)

    def rates(self, rows: Sequence[str]) -> RateTable:
        """Return the rates of some rows."""
        return RateTable(self.tasks, {row: self.reports[row] for row in rows})

    def both(self, row: str, task: str) -> tuple[list[bool], list[bool]] | None:
        """Return the success of a row and of the reference on the conditions that both attempted; None without any."""
        pair = [self.measured.get((name, task)) for name in (row, self.reference)]
        if row == self.reference or pair[0] is None or pair[1] is None:
            return None
        n = min(len(pair[0].attempts), len(pair[1].attempts))
        return pair[0].success[:n], pair[1].success[:n]

    def difference(self, row: str, task: str) -> PairedDifference | None:
        """Return by how much the reference succeeds more often than a row on a task; None where one is missing."""
        success = self.both(row, task)
        return None if success is None else paired_difference(*success)

    def ended(self, row: str, task: str) -> SequentialComparison | None:
        """Return where the comparison of a row with the reference could end; None where one is missing."""
        success = self.both(row, task)
        available = self.planned(row, task)
        return None if success is None else sequential_difference(*success, available=available)

    def planned(self, row: str, task: str) -> int:
        """Return the number of conditions of a pair, attempted or not."""
        identity = self.measured[row, task].header["identity"]
        return int(identity["blocks"] * identity["attempts"])

    def settings(self) -> dict[str, list[str]]:
        """Return the settings in which the tasks were measured, in words, each with its tasks."""
        found: dict[str, list[str]] = {}
        for task in self.tasks:
            for measurement in self._of(task)[:1]:
                setting = Setting.from_dict(measurement.header["identity"]["setting"])
                found.setdefault(str(setting), []).append(task)
        return found

    def header(self, task: str, name: str) -> Any:
        """Return an entry of the headers on a task; "-" where nothing was measured."""
        measurements = self._of(task)
        return measurements[0].header[name] if measurements else "-"

    def _of(self, task: str) -> list[Measurement]:
        return [found for row in self.rows if (found := self.measured.get((row, task))) is not None]

    def _check_same(self, task: str) -> None:
        paired = [found for found in self._of(task) if not is_unpaired(found.row)]
        for other in paired[1:]:
            n = min(len(paired[0].attempts), len(other.attempts))
            if other.ids[:n] != paired[0].ids[:n] or other.header["definition"] != paired[0].header["definition"]:
                raise ValueError(
                    f"{other.row} and {paired[0].row} were not measured on the same conditions of the same {task}, so "
                    "they are not compared. Measure them anew, in another --out."
                )


def reference_of(rows: Sequence[str]) -> str:
    """Return the row among paired ones that the others are compared with; "" without any."""
    return RESIDUAL if RESIDUAL in rows else next(iter(rows), "")


def label_of(row: str) -> str:
    """Return what the table calls a row."""
    return LABELS.get(row, row)


def speed_curve(measurement: Measurement) -> PsychometricCurve | None:
    """Return success against the speed of what moves; None on a task whose conditions have no speed."""
    span = measurement.header["speed_range"]
    speeds = [attempt.speed for attempt in measurement.attempts if attempt.speed is not None]
    if span is None or len(speeds) < len(measurement.attempts) or not speeds:
        return None
    rng = np.random.default_rng(0)
    return fit_curve(speeds, measurement.success, span=span, rng=rng, resamples=RESAMPLES)


def _report(measurement: Measurement) -> DgrReport:
    told = named_within(measurement.header["identity"]["setting"]["reflex"])
    bounds = measurement.header["difficulty_range"]
    return DgrReport.from_attempts(
        measurement.attempts, difficulty_range=bounds, n_bins=BINS, label=label_of(measurement.row), thresholds=told
    )
