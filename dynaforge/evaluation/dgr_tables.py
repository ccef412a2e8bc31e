"""Tables of demonstration generation rates as plain text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from statistics import mean

from rich.table import Table

from dynaforge.evaluation.dgr import DgrReport, cells, render
from dynaforge.evaluation.statistics import PairedDifference

_FORCES = {"lasting N": "lasting_forces", "peak N": "peak_forces"}
"""Columns with median, 90th percentile and maximum of the contact forces of successes, newtons: field of the report."""


def comparison_table(reports: Sequence[DgrReport], *, paired: PairedDifference | None = None, width: int = 80) -> str:
    """Return one row per report as plain text, and the paired gain below them if given.

    Args:
        reports: The reports.
        paired: The last report against the first, on the same conditions.
        width: Columns of text at most.
    """
    grid = Table()
    for name in ("", "n", "success", "95 %", "std of blocks"):
        grid.add_column(name, justify="left" if not name else "right")
    for report in reports:
        spread = f"{report.std:.1%}" if not math.isnan(report.std) else "-"
        grid.add_row(report.label, str(report.n), *cells(report.total), spread)
    text = "\n".join((render(grid, width), *map(describe_forces, reports))).rstrip()
    return text if paired is None else f"{text}\n{describe_gain(paired)}"


def task_table(reports: Mapping[str, Sequence[DgrReport]], *, width: int = 140) -> str:
    """Return the rates of generators over tasks as plain text, and their means over the tasks at the end.

    Args:
        reports: Task name to one report per generator, the same generators in the same order for every task.
        width: Columns of text at most.
    """
    grid = Table()
    forces = _force_columns(report for measured in reports.values() for report in measured)
    for name in ("task", "generator", "n", "success", "std", "95 %", *forces, "by difficulty, easy to hard, %"):
        grid.add_column(name, justify="left" if name in ("task", "generator") else "right")
    for task, measured in reports.items():
        for report in measured:
            bins = " ".join(f"{100 * b.rate:3.0f}" if b.n else "  -" for b in report.bins)
            rate, interval = cells(report.total)
            spread = "-" if math.isnan(report.std) else f"{report.std:.1%}"
            grid.add_row(task, report.label, str(report.n), rate, spread, interval, *_force_cells(report, forces), bins)
    grid.add_section()
    for measured in zip(*reports.values(), strict=True):
        average = mean(report.mean for report in measured)
        under = (_mean_under(measured, name) for name in forces)
        grid.add_row("mean", measured[0].label, str(sum(r.n for r in measured)), f"{average:.1%}", "", "", *under, "")
    return render(grid, width)


def describe_gain(paired: PairedDifference) -> str:
    """Return the result of a paired comparison in one line."""
    low, high = paired.interval
    p = f"p = {paired.p_value:.2g}" if paired.p_value >= 1e-4 else "p < 0.0001"
    return (
        f"paired gain {100 * paired.difference:+.1f} points, 95 % [{100 * low:+.1f}, {100 * high:+.1f}] "
        f"(of {paired.n} conditions, {paired.only_b} succeed only with it and {paired.only_a} only without it; "
        f"exact McNemar {p})"
    )


def describe_forces(report: DgrReport) -> str:
    """Return in one line what the forces of a report's attempts were; "" where they are not known."""
    if not report.under:
        return ""
    rates = ", ".join(f"{name} {count.rate:.1%}" for name, count in report.under.items())
    line = f"{report.label}: success with the reflex {rates}"
    for name, part in _FORCES.items():
        if (forces := getattr(report, part)) is not None:
            p50, p90, most = forces
            words = f"{p50:.0f} N (median), {p90:.0f} N (90 %), {most:.0f} N (most)"
            line += f"; {name.removesuffix(' N')} force of successes {words}"
    return line


def _force_columns(reports: Iterable[DgrReport]) -> tuple[str, ...]:
    """Return the columns about forces that a table of the reports has: named thresholds, and peak forces."""
    found = list(reports)
    names = dict.fromkeys(name for report in found for name in report.under)
    return (*names, *(name for name, part in _FORCES.items() if any(getattr(report, part) for report in found)))


def _force_cells(report: DgrReport, columns: Iterable[str]) -> tuple[str, ...]:
    found = {name: f"{count.rate:.1%}" for name, count in report.under.items()}
    for name, part in _FORCES.items():
        if (forces := getattr(report, part)) is not None:
            found[name] = "/".join(f"{newtons:.0f}" for newtons in forces)
    return tuple(found.get(name, "-") for name in columns)


def _mean_under(reports: Sequence[DgrReport], name: str) -> str:
    """Return the mean over tasks of the rates under a named threshold; "" where one is not known."""
    rates = [report.under[name].rate for report in reports if name in report.under]
    return f"{mean(rates):.1%}" if len(rates) == len(reports) else ""
