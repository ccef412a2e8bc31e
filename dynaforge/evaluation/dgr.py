"""The demonstration generation rate (DGR): successes over all attempts, with bins, blocks and failure reasons."""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from statistics import mean, stdev
from typing import Any, Protocol

import numpy as np
from rich.console import Console
from rich.table import Table

from dynaforge.evaluation.statistics import Interval, wilson_interval


class AttemptRecord(Protocol):
    """What a report needs to know of an attempt; `dynaforge.demos.Attempt` and `CountedAttempt` fit."""

    @property
    def difficulty(self) -> float:
        """Nominal difficulty of the condition, in the task's own unit."""

    @property
    def success(self) -> bool:
        """Whether the attempt succeeded."""

    @property
    def failure(self) -> str:
        """Why it failed; "" on success."""

    @property
    def block(self) -> int:
        """Number of the block that the condition belongs to."""


@dataclass(frozen=True, slots=True)
class CountedAttempt:
    """A plain `AttemptRecord`, for attempts that are only counted.

    Attributes:
        difficulty, success, failure, block: As in `AttemptRecord`.
    """

    difficulty: float
    success: bool
    failure: str = ""
    block: int = 0


@dataclass(frozen=True, slots=True)
class Count:
    """Successes among n attempts."""

    successes: int
    n: int

    @property
    def rate(self) -> float:
        """Success rate; NaN without attempts."""
        return self.successes / self.n if self.n else math.nan

    @property
    def interval(self) -> Interval:
        """Wilson 95 % interval."""
        return wilson_interval(self.successes, self.n)


@dataclass(frozen=True, slots=True, kw_only=True)
class DgrReport:
    """How often a generator succeeds. Every attempt counts: planner failures, exceptions and timeouts too.

    Attributes:
        label: What was measured, e.g. "planner only".
        total: Count of all attempts.
        blocks: Count of each block of conditions, in the order of their numbers.
        edges: Edges of the difficulty bins, ascending, one more than there are bins.
        bins: Count of each difficulty bin, the easiest first.
        failures: Number of failed attempts by reason, most frequent first.
        under: Successes that the reflex with these thresholds would have let happen, by their names; empty where loads
            are not known.
        peak_forces: Median, 90th percentile and greatest of the peak contact forces of successes, newtons; None without
            successes, or where loads are not known.
        lasting_forces: The same of the forces that lasted for two control steps, which the reflex judges.
    """

    label: str
    total: Count
    blocks: tuple[Count, ...]
    edges: tuple[float, ...]
    bins: tuple[Count, ...]
    failures: Mapping[str, int]
    under: Mapping[str, Count] = field(default_factory=dict)
    peak_forces: tuple[float, float, float] | None = None
    lasting_forces: tuple[float, float, float] | None = None

    @staticmethod
    def from_attempts(
        attempts: Iterable[AttemptRecord],
        *,
        difficulty_range: tuple[float, float],
        n_bins: int = 8,
        label: str = "",
        thresholds: Sequence[str] = (),
    ) -> DgrReport:
        """Count attempts.

        Args:
            attempts: Every attempt that was made, in any order.
            difficulty_range: Lowest and highest difficulty of the task; the bins divide it equally.
            n_bins: Number of difficulty bins.
            label: What was measured.
            thresholds: Names of the thresholds to count successes under; the attempts' loads have a share of each.

        Raises:
            ValueError: No attempts, an empty range, or a difficulty outside of it.
        """
        records = list(attempts)
        low, high = difficulty_range
        if not records or n_bins < 1 or not high > low:
            raise ValueError("A report needs attempts, at least one bin and a difficulty range (low, high).")
        bins: list[list[AttemptRecord]] = [[] for _ in range(n_bins)]
        blocks: dict[int, list[AttemptRecord]] = {}
        for record in records:
            bins[_bin_of(record.difficulty, low, high, n_bins)].append(record)
            blocks.setdefault(record.block, []).append(record)
        loads = [getattr(record, "loads", None) for record in records if record.success]
        known = None not in loads
        borne = [load for load in loads if load is not None] if known else []
        return DgrReport(
            label=label,
            total=_count(records),
            blocks=tuple(_count(blocks[key]) for key in sorted(blocks)),
            edges=tuple(low + (high - low) * i / n_bins for i in range(n_bins + 1)),
            bins=tuple(_count(members) for members in bins),
            failures=failure_counts(records),
            under={name: _bearing(loads, name, len(records)) for name in thresholds} if known else {},
            peak_forces=_spread([load.peak_force for load in borne]) if borne else None,
            lasting_forces=_spread([load.force for load in borne]) if borne else None,
        )

    @property
    def n(self) -> int:
        """Number of attempts."""
        return self.total.n

    @property
    def mean(self) -> float:
        """Mean of the block rates; with equal blocks this is the pooled rate."""
        return mean(block.rate for block in self.blocks)

    @property
    def std(self) -> float:
        """Sample standard deviation over blocks; NaN for a single block."""
        return stdev(block.rate for block in self.blocks) if len(self.blocks) > 1 else math.nan

    @property
    def interval(self) -> Interval:
        """Wilson 95 % interval of the pooled rate."""
        return self.total.interval

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain JSON data, with derived figures for readers of the file."""
        derived = {
            "rate": self.total.rate,
            "interval": list(self.interval),
            "std": None if math.isnan(self.std) else self.std,
        }
        return {
            "label": self.label,
            "total": asdict(self.total),
            "blocks": [asdict(block) for block in self.blocks],
            "edges": list(self.edges),
            "bins": [asdict(count) for count in self.bins],
            "failures": dict(self.failures),
            "derived": derived,
            **({"under": {name: asdict(count) for name, count in self.under.items()}} if self.under else {}),
            **({} if self.peak_forces is None else {"peak_forces": list(self.peak_forces)}),
            **({} if self.lasting_forces is None else {"lasting_forces": list(self.lasting_forces)}),
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> DgrReport:
        """Rebuild a report from `to_dict`; derived figures are computed again.

        Raises:
            ValueError: A field is missing or malformed.
        """
        try:
            return DgrReport(
                label=str(data["label"]),
                total=Count(**data["total"]),
                blocks=tuple(Count(**block) for block in data["blocks"]),
                edges=tuple(float(edge) for edge in data["edges"]),
                bins=tuple(Count(**count) for count in data["bins"]),
                failures={str(key): int(value) for key, value in data["failures"].items()},
                under={str(name): Count(**count) for name, count in data.get("under", {}).items()},
                peak_forces=_three(data.get("peak_forces")),
                lasting_forces=_three(data.get("lasting_forces")),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"Not a DGR report: {error!r}.") from error

    def table(self, *, width: int = 80) -> str:
        """Return bins, total and failure reasons as plain text, `width` columns wide at most."""
        grid = Table(title=self.label or None, title_justify="left")
        for name in ("difficulty", "n", "success", "95 %"):
            grid.add_column(name, justify="right")
        for low, high, count in zip(self.edges[:-1], self.edges[1:], self.bins, strict=True):
            grid.add_row(f"{low:.3g} - {high:.3g}", str(count.n), *cells(count))
        grid.add_section()
        grid.add_row("all", str(self.n), *cells(self.total))
        lines = [f"  {number:4d}  {reason}" for reason, number in self.failures.items()]
        return render(grid, width) + ("\nfailures\n" + "\n".join(lines) if lines else "")


def failure_counts(attempts: Iterable[AttemptRecord]) -> dict[str, int]:
    """Count the reasons of failed attempts, the most frequent first."""
    reasons = Counter(attempt.failure or "unnamed" for attempt in attempts if not attempt.success)
    return dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0])))


def ranked_reasons(reports: Iterable[DgrReport]) -> list[str]:
    """Return the failure reasons of all the reports, the most frequent over them together first."""
    totals: Counter[str] = Counter()
    for report in reports:
        totals.update(report.failures)
    return sorted(totals, key=lambda reason: (-totals[reason], reason))


def _bearing(loads: Iterable[Any], threshold: str, n: int) -> Count:
    """Count the successes whose load lies within a named threshold."""
    return Count(sum(getattr(load, threshold) <= 1.0 for load in loads), n)


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    """Return median, 90th percentile and maximum."""
    p50, p90 = np.percentile(values, (50, 90)).tolist()
    return p50, p90, max(values)


def _three(values: Any) -> tuple[float, float, float] | None:
    if values is None:
        return None
    p50, p90, most = map(float, values)
    return p50, p90, most


def _bin_of(difficulty: float, low: float, high: float, n_bins: int) -> int:
    if not low <= difficulty <= high:
        raise ValueError(f"Difficulty {difficulty:g} lies outside the task's range [{low:g}, {high:g}].")
    return min(int((difficulty - low) / (high - low) * n_bins), n_bins - 1)


def _count(records: Sequence[AttemptRecord]) -> Count:
    return Count(sum(bool(record.success) for record in records), len(records))


def cells(count: Count) -> tuple[str, str]:
    """Return the cells of a rate and its interval."""
    if not count.n:
        return "-", "-"
    low, high = count.interval
    return f"{count.rate:.1%}", f"{low:.1%} - {high:.1%}"


def render(grid: Table, width: int) -> str:
    """Return a table as plain text.

    Args:
        grid: The table.
        width: Columns of text at most.
    """
    console = Console(file=io.StringIO(), width=width, color_system=None, force_terminal=False)
    with console.capture() as capture:
        console.print(grid)
    return "\n".join(line.rstrip() for line in capture.get().rstrip().splitlines())
