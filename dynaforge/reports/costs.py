"""The table of costs: CPU-hours of a number of demonstrations per task, as measured, beside the paper's cost model."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.table import Table

from dynaforge.evaluation.costs import PAPER_HUMAN_MINUTES, PAPER_TASKS, REFERENCE, Cost, model_hours, paper_hours
from dynaforge.evaluation.dgr import render
from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions

NEVER, NONE = "never", "N/A"
SOME = 1e-4  # CPU-hours: what takes less than a third of a second is no preparation
PAIR_COLUMNS = ("task", "generator", "DGR", "CPU-s", "attempts", "95 %", "preparation h", "collection h", "sum h")
TOTAL_COLUMNS = ("generator", "attempts", "preparation h", "collection h", "sum h", "model h", "paper h")

Missing = Mapping[tuple[str, str], str]
"""Generator and task to why the generator does not do the task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CostTable:
    """Costs of several generators on several tasks.

    Attributes:
        tasks: Names of the tasks, in order.
        generators: Names of the generators, in order.
        costs: Generator and task to what the demonstrations cost.
        missing: Why other pairs have no cost.
    """

    tasks: tuple[str, ...]
    generators: tuple[str, ...]
    costs: Mapping[tuple[str, str], Cost]
    missing: Missing = field(default_factory=dict)

    @property
    def demos(self) -> int:
        """Number of demonstrations per task."""
        return next(iter(self.costs.values())).demos

    def of(self, generator: str) -> list[Cost] | None:
        """Return a generator's costs on all tasks; None where it does not support all of them."""
        found = [self.costs.get((generator, task)) for task in self.tasks]
        return None if None in found else [cost for cost in found if cost is not None]

    def model(self) -> dict[str, float]:
        """Return the hours of the paper's model with the measured DGR, by generator that supports all the tasks.

        Its assumptions stay the paper's: 4 hours of the reference's collection and 2.5 of its training. Empty where the
        reference was not measured on all the tasks or never succeeds on one.
        """
        rates = {name: [cost.count.rate for cost in costs] for name in self.generators if (costs := self.of(name))}
        return model_hours(rates) if REFERENCE in rates and all(rates[REFERENCE]) else {}

    def paper(self) -> dict[str, float]:
        """Return the hours in the paper's second table, by generator; empty where the tasks are not those."""
        return paper_hours() if set(self.tasks) == set(PAPER_TASKS) else {}

    def pair_rows(self) -> list[tuple[str, ...]]:
        """Return the cells of `PAIR_COLUMNS`, task by task."""
        return [
            (task, name, *_pair_cells(self.costs.get((name, task)))) for task in self.tasks for name in self.generators
        ]

    def total_rows(self) -> list[tuple[str, ...]]:
        """Return the cells of `TOTAL_COLUMNS`: sums over the tasks, and what the paper's model gives."""
        model, paper = self.model(), self.paper()
        return [
            (name, *_total_cells(self.of(name)), *(_hours(found.get(name)) for found in (model, paper)))
            for name in self.generators
        ]

    def text(self, *, width: int = 120) -> str:
        """Return both tables and their legend as plain text, `width` columns wide at most."""
        tables = ((PAIR_COLUMNS, self.pair_rows(), 2), (TOTAL_COLUMNS, self.total_rows(), 1))
        return "\n\n".join([*(_text(*table, width=width) for table in tables), self.legend()])

    def markdown(self) -> str:
        """Return both tables and their legend as Markdown."""
        tables = ((PAIR_COLUMNS, self.pair_rows()), (TOTAL_COLUMNS, self.total_rows()))
        return "\n\n".join([*(_markdown(*table) for table in tables), self.legend()]) + "\n"

    def latex(self) -> str:
        """Return the sums over the tasks as a LaTeX table for the package booktabs."""
        head = " & ".join(map(_escaped, TOTAL_COLUMNS))
        rows = [" & ".join(map(_escaped, row)) + r" \\" for row in self.total_rows()]
        columns = "l" + "r" * (len(TOTAL_COLUMNS) - 1)
        lines = [
            rf"% {self.demos} demonstrations for each of {', '.join(self.tasks)}",
            rf"\begin{{tabular}}{{@{{}}{columns}@{{}}}}",
            r"\toprule",
            rf"{head} \\",
            r"\midrule",
            *rows,
            r"\bottomrule",
            r"\end{tabular}",
        ]
        return "\n".join(lines) + "\n"

    def legend(self) -> str:
        """Return what the columns mean."""
        lines = (
            f"CPU-hours for {self.demos} demonstrations per task. {NONE}: the generator does not do the task.",
            "CPU-s: processor seconds of an attempt, mean over all attempts. attempts: those expected until so many",
            "succeed, demonstrations / DGR; 95 %: from the Wilson interval of the DGR; never: no attempt succeeded.",
            "preparation: training of the policy, recording of a source demonstration. model: hours of the paper's",
            "cost model with this DGR, which takes all attempts to cost the same, and the reference's collection to be",
            f"4 h and its training 2.5 h long; the reference is {REFERENCE}. paper: hours in the paper's second table.",
        )
        reasons = [f"{name} on {task}: {reason.rstrip('.')}." for (name, task), reason in self.missing.items()]
        return "\n".join([*lines, *reasons])

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON data; null where a generator never succeeds or does not support a task."""
        model, paper = self.model(), self.paper()
        pairs = [
            {"task": task, "generator": name, **_pair_data(self.costs[name, task])}
            for task in self.tasks
            for name in self.generators
            if (name, task) in self.costs
        ]
        totals = {
            name: {
                **_total_data(self.of(name)),
                "model_hours": _finite(model.get(name)),
                "paper_hours": paper.get(name),
                "paper_human_minutes": PAPER_HUMAN_MINUTES.get(name) if paper else None,
            }
            for name in self.generators
        }
        missing = [{"task": task, "generator": name, "reason": why} for (name, task), why in self.missing.items()]
        return {
            "demos": self.demos,
            "tasks": list(self.tasks),
            "pairs": pairs,
            "not_available": missing,
            "totals": totals,
        }


def _pair_cells(cost: Cost | None) -> tuple[str, ...]:
    if cost is None:
        return (NONE,) + ("",) * (len(PAIR_COLUMNS) - 3)
    low, high = cost.attempts_interval
    return (
        f"{cost.count.rate:.1%}",
        f"{cost.seconds:.2f}",
        _number(cost.attempts) if cost.count.successes else f"{NEVER} in {cost.count.n}",
        f"{_number(low)} - {_number(high)}" if math.isfinite(high) else f"over {_number(low)}",
        _hours(cost.preparation),
        _hours(cost.collection),
        _hours(cost.total),
    )


def _total_cells(costs: Sequence[Cost] | None) -> tuple[str, ...]:
    if costs is None:
        return (NONE,) * 4
    attempts = sum(cost.attempts for cost in costs)
    sums = (sum(getattr(cost, name) for cost in costs) for name in ("preparation", "collection", "total"))
    return (_number(attempts), *map(_hours, sums))


def _pair_data(cost: Cost) -> dict[str, Any]:
    return {
        "successes": cost.count.successes,
        "n": cost.count.n,
        "rate": cost.count.rate,
        "interval": list(cost.count.interval),
        "cpu_seconds": cost.seconds,
        "attempts": _finite(cost.attempts),
        "attempts_interval": [_finite(end) for end in cost.attempts_interval],
        "preparation_hours": cost.preparation,
        "collection_hours": _finite(cost.collection),
        "hours": _finite(cost.total),
    }


def _total_data(costs: Sequence[Cost] | None) -> dict[str, Any]:
    stored = {
        "attempts": "attempts",
        "preparation": "preparation_hours",
        "collection": "collection_hours",
        "total": "hours",
    }
    if costs is None:
        return dict.fromkeys(stored.values())
    return {name: _finite(sum(getattr(cost, field) for cost in costs)) for field, name in stored.items()}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _number(attempts: float) -> str:
    return f"{attempts:,.0f}" if math.isfinite(attempts) else NEVER


def _hours(hours: float | None) -> str:
    if hours is None:
        return "-"
    if math.isinf(hours):
        return NEVER
    return "< 0.01" if SOME <= hours < 0.01 else f"{hours:.2f}"


def _text(columns: Sequence[str], rows: Sequence[Sequence[str]], names: int, *, width: int) -> str:
    """Return a table as plain text, whose first columns are names and the others figures."""
    grid = Table()
    for index, column in enumerate(columns):
        grid.add_column(column, justify="left" if index < names else "right")
    for row in rows:
        grid.add_row(*row)
    return render(grid, width)


def _markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _escaped(cell: str) -> str:
    return cell.replace("%", r"\%").replace("_", r"\_").replace("< ", "$<$ ")


def write_costs(folder: Path, table: CostTable, *, command: str, origin: Mapping[str, Any]) -> list[Path]:
    """Write the table as Markdown, LaTeX and JSON.

    Args:
        folder: Where `table2.md`, `table2.tex` and `table2.json` are written.
        table: The table.
        command: The command that made it.
        origin: What it was made from, as plain data.

    Returns:
        The paths of the files.
    """
    title = f"# What {table.demos} demonstrations per task cost\n\n```\n{command}\n```\n\n"
    data = {"command": command, "date": f"{datetime.now(UTC):%Y-%m-%d}", "versions": package_versions(), **origin}
    contents = {
        "table2.md": title + table.markdown(),
        "table2.tex": table.latex(),
        "table2.json": json.dumps(data | table.to_dict(), indent=1) + "\n",
    }
    for name, content in contents.items():
        atomic_write(folder / name, content.encode())
    return [folder / name for name in contents]
