"""The finished runs of a task in one file, `TASK/runs.json`, so that their folders need not be kept.

It contains the JSON files of each run: settings and versions, training history, outcome on every condition. The table
and the figures of `dynaforge compare` are computed from these. Policies are not in it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from dynaforge.files.atomic import atomic_write

ARCHIVE = "runs.json"
EVALUATED = "exam.json"
"""The file with a run's evaluation, written last."""

RUN_FILES = ("run.json", "history.json", EVALUATED)

RunFiles = dict[str, Any]
"""The files of a run: name to content."""


def read_run(folder: Path) -> RunFiles:
    """Return the files of a finished run: from its folder or, where that is gone, from the archive of its task.

    Raises:
        ValueError: A file or the archive is damaged; the message names it.
    """
    if not (folder / EVALUATED).is_file():
        return read_archive(_archive_of(folder)).get(_key(folder), {})
    return {name: _read_json(folder / name) for name in RUN_FILES if (folder / name).is_file()}


def is_finished(folder: Path) -> bool:
    """Return whether a run is complete, its evaluation included."""
    return (folder / EVALUATED).is_file() or _key(folder) in read_archive(_archive_of(folder))


def write_archives(folders: Iterable[Path]) -> None:
    """Add finished runs to the archives of their tasks.

    Raises:
        ValueError: An archive is damaged, or contains runs that were evaluated on other conditions.
    """
    by_archive: dict[Path, dict[str, RunFiles]] = {}
    for folder in folders:
        path = _archive_of(folder)
        by_archive.setdefault(path, read_archive(path))[_key(folder)] = read_run(folder)
    for path, runs in by_archive.items():
        atomic_write(path, _archive_text(path, runs).encode())
    _parsed.cache_clear()  # the clock of a file system may be too coarse to tell two writes apart


def _archive_text(path: Path, runs: Mapping[str, RunFiles]) -> str:
    """Return the JSON of an archive, one line per condition and per run; the runs share the list of conditions."""
    conditions: list[dict[str, Any]] = []
    lines = []
    for key, files in sorted(runs.items()):
        evaluated = dict(files[EVALUATED])
        attempts = [dict(attempt) for attempt in evaluated.pop("attempts")]
        evaluated["outcomes"] = [attempt.pop("outcome") for attempt in attempts]
        conditions = conditions or attempts
        if attempts != conditions:
            raise ValueError(f"The runs in {path} were evaluated on different conditions.")
        lines.append(f"{json.dumps(key)}: {json.dumps({**files, EVALUATED: evaluated})}")
    listed, stored = ",\n".join(map(json.dumps, conditions)), ",\n".join(lines)
    return f'{{"conditions": [\n{listed}\n], "runs": {{\n{stored}\n}}}}\n'


def read_archive(path: Path) -> dict[str, RunFiles]:
    """Return the files of every run in an archive by the run's name; empty where there is no archive.

    Raises:
        ValueError: The archive is damaged.
    """
    return dict(_parsed(path, path.stat().st_mtime_ns)) if path.is_file() else {}


@lru_cache(maxsize=16)
def _parsed(path: Path, written_at: int) -> dict[str, RunFiles]:
    """Read an archive, once until it is written again: `written_at` is only part of the key of the cache."""
    try:
        data = json.loads(path.read_text())
        return {key: _with_attempts(files, data["conditions"]) for key, files in data["runs"].items()}
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not an archive of runs: {type(error).__name__}: {error}.") from error


def _with_attempts(files: Mapping[str, Any], conditions: list[dict[str, Any]]) -> RunFiles:
    """Return a run's files as they were before archiving, each outcome beside its condition again."""
    evaluated = dict(files[EVALUATED])
    outcomes = evaluated.pop("outcomes")
    evaluated["attempts"] = [c | {"outcome": outcome} for c, outcome in zip(conditions, outcomes, strict=True)]
    return {**files, EVALUATED: evaluated}


def _archive_of(folder: Path) -> Path:
    """Return the archive of the task that a run's folder belongs to: TASK/planner_only, TASK/VARIANT/seed-0."""
    return (folder.parents[1] if folder.name.startswith("seed-") else folder.parent) / ARCHIVE


def _key(folder: Path) -> str:
    """Return the name of a run in the archive: its folder below that of the task."""
    return folder.relative_to(_archive_of(folder).parent).as_posix()


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not readable JSON: {error}.") from error
