"""The files of the first table: Markdown, LaTeX, JSON, and the picture of the curves; and its text for the terminal."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dynaforge.evaluation.rate_table import Rate
from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions
from dynaforge.reports import table1_sections as sections
from dynaforge.reports.plots import psychometric_curves
from dynaforge.reports.rate_grid import MARKS, latex_table, markdown_lines, markdown_table, plain_table
from dynaforge.reports.table1 import PLANNER, RESIDUAL, Table1, label_of

CURVES = "table1-curves.svg"


def terminal_text(table: Table1) -> str:
    """Return the table as a command prints it, with what is N/A and why."""
    parts = [
        plain_table(sections.headings(table), sections.rate_section(table)),
        f"{MARKS[0]} best, {MARKS[1]} second best of the paired generators",
        *sections.notes(table),
        *sections.refusals(table),
    ]
    for line in sections.difference_rows(table):
        parts.append(f"{label_of(table.reference)} less {line[0]}: mean over the tasks {line[-1]} points")
    if table.sequential:
        parts += [f"{line[0]}, compared until decided: {line[-1]}" for line in sections.saving_rows(table)]
    return "\n".join(parts)


def write_table1(folder: Path, table: Table1, *, command: str, minutes: float) -> list[Path]:
    """Write `table1.md`, `table1.tex`, `table1.json` and the picture of the curves into a folder.

    Args:
        folder: The folder.
        table: The table.
        command: The command that made it.
        minutes: How long all its attempts took, in minutes of one core.

    Returns:
        The files.

    Raises:
        ImportError: Matplotlib, of the `[report]` extra, is missing.
        OSError: The folder is not writable, or the disk is full.
    """
    origin = {"command": command, "date": f"{datetime.now(UTC):%Y-%m-%d}", "core_minutes": round(minutes, 1)}
    panels = {
        task: {
            label_of(row): (table.curves[row, task], table.reports[row][task])
            for row in table.paired
            if (row, task) in table.curves
        }
        for task in table.tasks
    }
    panels = {task: curves for task, curves in panels.items() if curves}
    skills = [str(table.header(task, "skill")) for task in table.tasks]
    lines, notes = sections.rate_section(table), " ".join(sections.notes(table))
    tex = latex_table(sections.headings(table, "Generator"), skills, lines, notes=notes)
    files = {
        "table1.md": "\n".join(_markdown(table, origin, curves=bool(panels))).encode(),
        "table1.tex": f"% {command}\n{tex}".encode(),
        "table1.json": json.dumps(origin | _data(table), indent=1).encode() + b"\n",
        **({CURVES: psychometric_curves(panels)} if panels else {}),
    }
    for name, content in files.items():
        atomic_write(folder / name, content)
    return [folder / name for name in files]


def _markdown(table: Table1, origin: dict[str, Any], *, curves: bool) -> Iterator[str]:
    headings, tasks = sections.headings(table), table.tasks
    identities = [found.header["identity"] for found in table.measured.values()]
    conditions = ", ".join(
        dict.fromkeys(f"stream {i['stream']}, {i['blocks']} x {i['attempts']} conditions" for i in identities)
    )
    yield f"# Table I\n\n{conditions}; {origin['date']}; attempts took {origin['core_minutes']:g} minutes of one core."
    yield from (f"Setting of {', '.join(names)}: {setting}." for setting, names in table.settings().items())
    yield f"\n```\n{origin['command']}\n```\n"
    skills = ["*skill*", *(str(table.header(task, "skill")) for task in tasks), ""]
    first, rule, *rest = markdown_lines(headings, sections.rate_section(table)).splitlines()
    yield "\n".join((first, rule, f"| {' | '.join(skills)} |", *rest))
    yield "\n" + "\n".join(sections.notes(table)) + "\n"
    yield "".join(f"- {reason}\n" for reason in sections.refusals(table))
    reference = label_of(table.reference)
    names, under = sections.threshold_rows(table)
    wilson = "Wilson's 95 % intervals of the rates, in per cent."
    yield sections.section("Intervals", wilson, headings, sections.interval_rows(table))
    yield sections.section(
        "Paired differences",
        f"By how many points {reference} succeeds more often on the same conditions, with Newcombe's 95 % interval; on "
        "how many it alone succeeds, and the other alone; exact McNemar test.",
        headings,
        sections.difference_rows(table),
    )
    yield sections.section(
        "Under other thresholds of the reflex",
        f"Success in per cent that is left where the robot stops by {names}, from the loads of the attempts.",
        headings,
        under if names else [],
    )
    picture = f"![Success against speed]({CURVES})\n\n" if curves else ""
    yield sections.section(
        "Critical speeds",
        f"{picture}The speed at which success falls to one half, m/s, by a logistic curve with a free ceiling; 95 % "
        "bootstrap interval over conditions. In the picture, dots are rates of difficulty bins.",
        headings[:-1],
        sections.critical_rows(table),
    )
    if table.sequential:
        yield sections.section(
            "Comparisons that ended early",
            f"Conditions until the test at level 5 % that may be looked at after each of them found a difference "
            f"between {reference} and the generator, and the interval of the difference there (betting; "
            "`dynaforge.evaluation.sequential`). Rates of what ended early are those of fewer conditions, and "
            "differences look larger there than they are.",
            headings,
            sections.saving_rows(table),
        )
    yield "## Failures\n"
    for task, columns, rows in sections.failure_tables(table):
        yield f"### {task}\n\n{markdown_table(columns, rows)}\n"
    elsewhere = "In other physics, with other conditions."
    yield sections.section("The paper's table", elsewhere, headings, sections.paper_rows(tasks))


def _data(table: Table1) -> dict[str, Any]:
    """Return the table as plain JSON data."""
    rates = table.rates(table.rows)
    cells: dict[str, dict[str, Any]] = {row: {} for row in table.rows}
    for row in table.rows:
        for task in table.tasks:
            if (rate := rates.rate(row, task)) is not None:
                cells[row][task] = _rate(rate) | {"report": table.reports[row][task].to_dict()}
                if (row, task) in table.curves:
                    cells[row][task]["critical_speed"] = table.curves[row, task].to_dict()
                if (paired := table.difference(row, task)) is not None:
                    cells[row][task]["reference_less_this"] = asdict(paired)
                if table.sequential and (ended := table.ended(row, task)) is not None:
                    cells[row][task]["sequential"] = asdict(ended)
            elif (row, task) in table.refused:
                cells[row][task] = {"not_available": table.refused[row, task]}
    means = {row: None if (found := rates.mean(row)) is None else _rate(found) for row in table.rows}
    compared = (*table.tasks, None) if table.gains else ()
    gains = {task or sections.MEAN: rates.gain(RESIDUAL, PLANNER, task) for task in compared}
    return {
        "versions": package_versions(),
        "tasks": list(table.tasks),
        "rows": {row: label_of(row) for row in table.rows},
        "unpaired": list(table.unpaired),
        "reference": table.reference,
        "settings": table.settings(),
        "means": means,
        "gains": gains,
        "cells": cells,
    }


def _rate(rate: Rate) -> dict[str, float]:
    return {"mean": rate.mean, "std": rate.std}
