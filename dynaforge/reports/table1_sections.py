"""What stands below the first table: intervals, paired differences, thresholds, failures, critical speeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from statistics import mean

from dynaforge.evaluation import DgrReport
from dynaforge.evaluation.dgr import ranked_reasons
from dynaforge.evaluation.paper import PAPER_DGR, PAPER_NAMES
from dynaforge.reports.rate_grid import NOT_AVAILABLE, NOT_MEASURED, Line, gain_line, markdown_table, rate_lines
from dynaforge.reports.table1 import PLANNER, RESIDUAL, Table1, label_of

MOST_REASONS = 8
MEAN = "mean"

Headings = list[str]
Rows = list[list[str]]


def rate_section(table: Table1) -> list[Line]:
    """Return the lines of the table itself: the generators, the gains, and in a part of its own what is unpaired."""
    lines = rate_lines(table.rates(table.paired), _labels(table.paired), table.refused)
    if table.gains:
        lines.append(gain_line(table.rates(table.paired), RESIDUAL, PLANNER))
    apart = rate_lines(table.rates(table.unpaired), _labels(table.unpaired), table.refused)
    # Its rates stand beside no others, so none of them is the best.
    for k, line in enumerate(apart):
        lines.append(Line(line.label, tuple(replace(cell, place=None) for cell in line.cells), opens=k == 0))
    return lines


def headings(table: Table1, first: str = "") -> Headings:
    """Return the headings of a table with a column for each task and one for the mean."""
    return [first or "generator", *table.tasks, MEAN]


def notes(table: Table1) -> list[str]:
    """Return sentences about what the table shows."""
    sentences = [
        "Rate of successful attempts in per cent, mean and standard deviation over blocks of conditions (with their "
        "number in the denominator, as in the paper).",
        "The mean of a generator is over the tasks that it does.",
        "N/A: the generator does not do the task.",
    ]
    if table.gains:
        sentences.append("The gain is the residual's rate less the planner's, in percentage points.")
    sentences += [f"{label_of(row)} stands apart: its object's motion is prescribed." for row in table.unpaired]
    leads: dict[float, list[str]] = {}
    for (_, task), found in table.measured.items():
        leads.setdefault(found.header["lead_time"], []).append(task)
    told = [f"{seconds:g} s ({', '.join(tasks)})" for seconds, tasks in sorted(leads.items()) if seconds]
    return [*sentences, *([f"The prediction is by {', '.join(told)}."] if told else [])]


def interval_rows(table: Table1) -> Rows:
    """Return Wilson's 95 % intervals of the rates, in per cent."""
    return _by_report(table, lambda report: "{:.1f} - {:.1f}".format(*(100 * end for end in report.interval)))


def difference_rows(table: Table1) -> Rows:
    """Return how much more often the reference succeeds than each other paired row, with its interval and McNemar."""
    rows = []
    for row in table.paired:
        if row == table.reference:
            continue
        cells = []
        for task in table.tasks:
            paired = table.difference(row, task)
            if paired is None:
                cells.append(_absent(table, row, task))
                continue
            low, high = (100 * end for end in paired.interval)
            p = f"p = {paired.p_value:.2g}" if paired.p_value >= 1e-4 else "p < 0.0001"
            cells.append(
                f"{100 * paired.difference:+.1f} [{low:+.1f}, {high:+.1f}], {paired.only_b} : {paired.only_a}, {p}"
            )
        known = [paired.difference for task in table.tasks if (paired := table.difference(row, task)) is not None]
        rows.append([label_of(row), *cells, f"{100 * mean(known):+.1f}" if known else NOT_MEASURED])
    return rows


def threshold_rows(table: Table1) -> tuple[str, Rows]:
    """Return the names of the thresholds, and the rates that are left under each of them, in per cent."""
    found = [report for reports in table.reports.values() for report in reports.values()]
    names = list(dict.fromkeys(name for report in found for name in report.under))

    def cell(report: DgrReport) -> str:
        return " / ".join(
            f"{100 * report.under[name].rate:.1f}" if name in report.under else NOT_MEASURED for name in names
        )

    rows = _by_report(table, cell)
    for line, row in zip(rows, table.rows, strict=True):
        reports = list(table.reports[row].values())
        if reports and all(set(names) <= set(report.under) for report in reports):
            line[-1] = " / ".join(f"{100 * mean(report.under[name].rate for report in reports):.1f}" for name in names)
    return " / ".join(names), rows


def failure_tables(table: Table1) -> Iterator[tuple[str, Headings, Rows]]:
    """Yield a table for each task: how many attempts of each generator failed for each reason."""
    for task in table.tasks:
        reports = {row: found for row in table.rows if (found := table.reports[row].get(task)) is not None}
        if not reports:
            continue
        ranked = ranked_reasons(reports.values())
        rows = [
            [reason, *(str(report.failures.get(reason, 0)) for report in reports.values())]
            for reason in ranked[:MOST_REASONS]
        ]
        if rest := ranked[MOST_REASONS:]:
            rows.append(["other", *(str(sum(r.failures.get(name, 0) for name in rest)) for r in reports.values())])
        rows.append(["success", *(str(report.total.successes) for report in reports.values())])
        rows.append(["attempts", *(str(report.n) for report in reports.values())])
        yield task, ["", *(label_of(row) for row in reports)], rows


def critical_rows(table: Table1) -> Rows:
    """Return the critical speed of each paired row on each task with its interval, m/s."""
    return [
        [
            label_of(row),
            *(
                table.curves[row, task].describe() if (row, task) in table.curves else _absent(table, row, task)
                for task in table.tasks
            ),
        ]
        for row in table.paired
    ]


def saving_rows(table: Table1) -> Rows:
    """Return how many attempts each comparison with the reference took until it was decided, and the saving."""
    rows = []
    for row in table.paired:
        cells, used, available = [], 0, 0
        for task in table.tasks:
            ended = None if row == table.reference else table.ended(row, task)
            if ended is None:
                cells.append(NOT_MEASURED if row == table.reference else _absent(table, row, task))
                continue
            low, high = (100 * end for end in ended.interval)
            used, available = used + ended.n, available + ended.available
            verdict = "" if ended.decided else " undecided,"
            cells.append(f"{ended.n} of {ended.available},{verdict} [{low:+.1f}, {high:+.1f}]")
        if available:
            rows.append([label_of(row), *cells, f"{100 * (1 - used / available):.0f} % saved"])
    return rows


def refusals(table: Table1) -> list[str]:
    """Return why pairs are N/A, one sentence for each."""
    return [f"{label_of(row)}, {task}: {' '.join(why.split())}" for (row, task), why in table.refused.items()]


def paper_rows(tasks: Sequence[str]) -> Rows:
    """Return the paper's own table for the tasks that it has."""
    rows = []
    for row, cells in PAPER_DGR.items():
        texts = []
        for task in tasks:
            cell = cells.get(task)
            texts.append(NOT_AVAILABLE if cell is None else f"{cell[0]:.2f} ±{cell[1]:.2f}")
        known = [cell[0] for task in tasks if (cell := cells.get(task)) is not None]
        rows.append([f"paper: {PAPER_NAMES[row]}", *texts, f"{mean(known):.2f}" if known else NOT_AVAILABLE])
    return rows


def section(title: str, text: str, columns: Headings, rows: Rows) -> str:
    """Return a section in Markdown: a title, a text and a table; "" without rows."""
    return f"## {title}\n\n{text}\n\n{markdown_table(columns, rows)}\n" if rows else ""


def _labels(rows: Sequence[str]) -> list[tuple[str, str]]:
    return [(row, label_of(row)) for row in rows]


def _absent(table: Table1, row: str, task: str) -> str:
    return NOT_AVAILABLE if (row, task) in table.refused else NOT_MEASURED


def _by_report(table: Table1, text: Callable[[DgrReport], str]) -> Rows:
    """Return a row for each generator with a text about its report on each task, and nothing about the mean."""
    return [
        [
            label_of(row),
            *(
                text(table.reports[row][task]) if task in table.reports[row] else _absent(table, row, task)
                for task in table.tasks
            ),
            "",
        ]
        for row in table.rows
    ]
