"""The folder of the first table: one file for each pair of generator and task, and why the other pairs have none."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dynaforge.files.atomic import atomic_write
from dynaforge.generators.measurements import Measurement
from dynaforge.reports.table1 import Table1

REFUSED = "refused.json"

Refused = dict[tuple[str, str], str]
"""Row and task to why the generator does not do the task."""


def pair_path(folder: Path, row: str, task: str) -> Path:
    """Return the file of a pair."""
    return folder / task / f"{row}.json"


def note_refused(folder: Path, refused: Refused, tasks: Sequence[str], rows: Sequence[str]) -> None:
    """Store why pairs are not available, beside what was noted of others before.

    Args:
        folder: The folder, which exists.
        refused: The pairs that are not.
        tasks: The tasks that this says everything of, for some rows.
        rows: These rows.

    Raises:
        ValueError: What was noted before is damaged.
    """
    noted = _noted(folder)
    for task in tasks:
        kept = {row: why for row, why in noted.get(task, {}).items() if row not in rows}
        noted[task] = kept | {row: why for (row, name), why in refused.items() if name == task}
    atomic_write(folder / REFUSED, json.dumps(noted, indent=1).encode() + b"\n")


def read_table(folder: Path, tasks: Sequence[str], rows: Sequence[str], *, sequential: bool = False) -> Table1:
    """Read what is stored of some rows and tasks; a task of which there is nothing is left out.

    Args:
        folder: The folder.
        tasks: Columns of the table.
        rows: Rows of the table.
        sequential: Whether comparisons were allowed to end early.

    Raises:
        ValueError: A file is damaged, or nothing is stored, or pairs were not measured on the same conditions.
    """
    paths = {(row, task): pair_path(folder, row, task) for task in tasks for row in rows}
    noted = _noted(folder)
    refused = {(row, task): noted[task][row] for row, task in paths if row in noted.get(task, {})}
    # What is refused now may have been measured once, when the task or its policy was another.
    found = {key: path for key, path in paths.items() if key not in refused and path.is_file()}
    if not found:
        raise ValueError(f"{folder} holds nothing of these generators and tasks.")
    measured = {key: Measurement.load(path) for key, path in found.items()}
    known = {task for _, task in (*measured, *refused)}
    shown = tuple(task for task in tasks if task in known)
    return Table1(tasks=shown, rows=tuple(rows), measured=measured, refused=refused, sequential=sequential)


def _noted(folder: Path) -> dict[str, dict[str, str]]:
    path = folder / REFUSED
    if not path.is_file():
        return {}
    try:
        noted: Any = json.loads(path.read_text(encoding="utf-8"))
        return {str(task): {str(row): str(why) for row, why in rows.items()} for task, rows in noted.items()}
    except (ValueError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path} is damaged ({error}). Remove it.") from None
