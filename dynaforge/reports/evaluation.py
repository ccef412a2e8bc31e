"""What `dynaforge evaluate` measures and stores: the DGR of each generator, and its gain over the first one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dynaforge.demos import Attempt
from dynaforge.evaluation import DgrReport, PairedDifference, paired_difference
from dynaforge.evaluation.dgr_tables import describe_gain
from dynaforge.evaluation.sequential import SequentialComparison, sequential_difference
from dynaforge.evaluation.statistics import no_bin_worse
from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions
from dynaforge.sim.reflex import named_within
from dynaforge.tasks import Task
from dynaforge.tasks.digest import definition_of

BINS = 8
"""Number of difficulty bins in which success is reported."""

Measured = Mapping[str, Sequence[Attempt]]
"""Name of each generator to its attempts, all on the same conditions in the same order."""


@dataclass(frozen=True, slots=True)
class Gain:
    """A generator compared with the first one, condition by condition.

    Attributes:
        generator: Name of the generator.
        against: Name of the first one.
        paired: The difference of their DGR.
        worse_bins: Indices of the bins in which it is worse beyond the margin of `no_bin_worse`; None where the
            conditions are not spread evenly over the bins.
        ended: Where the comparison could end, if it was allowed to end early.
    """

    generator: str
    against: str
    paired: PairedDifference
    worse_bins: tuple[int, ...] | None
    ended: SequentialComparison | None = None

    @property
    def text(self) -> str:
        """The gain in one line, and more about where the comparison ended and about the bins if they were compared."""
        line = f"{self.generator} against {self.against}: {describe_gain(self.paired)}"
        if self.ended is not None:
            line += f"\n{self.ended.describe()}"
        if self.worse_bins is None:
            return line
        if not self.worse_bins:
            return f"{line}\nworse in none of {BINS} difficulty bins"
        bins = ", ".join(str(index + 1) for index in self.worse_bins)
        return f"{line}\nworse in difficulty bins {bins} (1 to {BINS}, easiest first)"

    def to_dict(self) -> dict[str, Any]:
        """Return the gain as plain JSON data."""
        data: dict[str, Any] = {
            "against": self.against,
            "difference": self.paired.difference,
            "interval": list(self.paired.interval),
            "p": self.paired.p_value,
        }
        if self.ended is not None:
            data["sequential"] = asdict(self.ended)
        if self.worse_bins is not None:
            data["no_bin_lost"] = {"holds": not self.worse_bins, "lost": list(self.worse_bins)}
        return data


def reports_of(task: Task, measured: Measured) -> list[DgrReport]:
    """Return the DGR of every generator, labelled with its name."""
    bounds, told = task.conditions.difficulty_range, named_within(task.setting.reflex)
    return [
        DgrReport.from_attempts(attempts, difficulty_range=bounds, n_bins=BINS, label=name, thresholds=told)
        for name, attempts in measured.items()
    ]


def by_generator(attempts: Sequence[Attempt]) -> dict[str, list[Attempt]]:
    """Group attempts by the name of their generator, in alphabetical order."""
    names = sorted({attempt.generator for attempt in attempts})
    return {name: [attempt for attempt in attempts if attempt.generator == name] for name in names}


def gains_over_first(task: Task, measured: Measured, *, sequential: bool = False) -> list[Gain]:
    """Compare every generator with the first one, on the conditions that both attempted.

    Args:
        task: The task.
        measured: The attempts; those of a generator after the first may have ended early.
        sequential: Whether they were allowed to.
    """
    (first, attempts), *others = measured.items()
    gains = []
    for name, others_attempts in others:
        n = len(others_attempts)
        before, after = ([attempt.success for attempt in made[:n]] for made in (attempts, others_attempts))
        worse = no_bin_worse(_by_bin(before), _by_bin(after)).worse if _evenly_spread(task, attempts[:n]) else None
        ended = sequential_difference(before, after, available=len(attempts)) if sequential else None
        gains.append(Gain(name, first, paired_difference(before, after), worse, ended))
    return gains


def write_evaluation(
    path: Path,
    task: Task,
    measured: Measured,
    *,
    reports: Sequence[DgrReport],
    gains: Sequence[Gain],
    policies: Mapping[str, Mapping[str, Any]],
    command: str,
) -> None:
    """Write what was measured on one task, every outcome included, as JSON.

    Args:
        path: The file.
        task: The task.
        measured: The attempts of every generator.
        reports: What `reports_of` makes of them.
        gains: Those of the generators after the first.
        policies: Of every generator with a policy, what tells which it is, as plain data.
        command: The command that measured it.
    """
    conditions = next(iter(measured.values()))
    data = {
        "task": task.name,
        **definition_of(task),
        "policies": policies,
        "reports": [report.to_dict() for report in reports],
        "gains": {gain.generator: gain.to_dict() for gain in gains},
        "conditions": [
            {"id": attempt.condition.id, "block": attempt.block, "difficulty": round(attempt.difficulty, 4)}
            for attempt in conditions
        ],
        "outcomes": {name: [str(attempt.outcome) for attempt in attempts] for name, attempts in measured.items()},
        "cpu_seconds": {name: [_rounded(attempt.cpu_seconds) for attempt in found] for name, found in measured.items()},
    }
    _write(path, command, data)


def write_task_table(path: Path, table: Mapping[str, Sequence[DgrReport]], *, minutes: float, command: str) -> None:
    """Write the DGR on several tasks as JSON.

    Args:
        path: The file.
        table: Reports of each task.
        minutes: How long measuring them took.
        command: The command that measured them.
    """
    reports = {task: [report.to_dict() for report in found] for task, found in table.items()}
    _write(path, command, {"minutes": round(minutes, 1), "tasks": reports})


def _evenly_spread(task: Task, attempts: Sequence[Attempt]) -> bool:
    """Return whether attempt i lies in bin i modulo `BINS`, as `--strata` draws them."""
    return len(attempts) % BINS == 0 and all(
        task.conditions.stratum(attempt.difficulty, BINS) == i % BINS for i, attempt in enumerate(attempts)
    )


def _by_bin(success: Sequence[bool]) -> list[Sequence[bool]]:
    """Return the success of evenly spread attempts bin by bin."""
    return [success[k::BINS] for k in range(BINS)]


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 4)


def _write(path: Path, command: str, data: dict[str, Any]) -> None:
    origin = {"command": command, "date": datetime.now(UTC).strftime("%Y-%m-%d"), "versions": package_versions()}
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, json.dumps(origin | data, indent=1).encode() + b"\n")
