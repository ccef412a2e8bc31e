"""`dynaforge bench`: the project's figures of speed, determinism, limits and forces, measured on this machine."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import Any

from dynaforge.benchmarks.figure import Figure
from dynaforge.benchmarks.suite import LONG, MEASUREMENTS, QUIET_LOAD, describe_machine, table
from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.files.atomic import atomic_write, check_writable
from dynaforge.files.versions import package_versions


def run(options: argparse.Namespace) -> int:
    """Measure and print the table; return 1 when a figure is missed, else 0.

    Raises:
        ValueError: A task is unknown.
        OSError: `--out` cannot be written.
    """
    tasks = chosen_tasks(options)
    chosen = _chosen(options.only)
    if options.out is not None:
        _check_out(options.out)
    machine = describe_machine()
    if machine["load"] > QUIET_LOAD:
        print(f"note: the load is {machine['load']:.1f}; figures of speed hold only where nothing else runs")
    start, figures = time.monotonic(), dict[str, list[Figure]]()
    for number, (task, name) in enumerate(product(tasks, chosen), 1):
        title = name if len(tasks) == 1 else f"{task.name}: {name}"
        print(f"[{number}/{len(tasks) * len(chosen)}] {title}", file=sys.stderr, flush=True)
        found = MEASUREMENTS[name](task, options.rounds)
        figures[title] = found if len(tasks) == 1 else [replace(f, title=f"{task.name}: {f.title}") for f in found]
    print(table([figure for found in figures.values() for figure in found]))
    if options.out is not None:
        atomic_write(options.out, json.dumps(_record(figures, options, machine), indent=1).encode())
        print(f"\nwritten to {options.out}")
    missed = [name for name, found in figures.items() if not all(figure.ok for figure in found)]
    verdict = f"missed: {', '.join(missed)}" if missed else "every figure is met"
    print(f"\n{verdict}; took {time.monotonic() - start:.0f} s")
    return 1 if missed else 0


def _chosen(only: Sequence[str] | None) -> list[str]:
    return [name for name in MEASUREMENTS if (name not in LONG if only is None else name in only)]


def _check_out(out: Path) -> None:
    if out.is_dir():
        raise ValueError(f"--out {out} is a folder; name a file in it.")
    out.parent.mkdir(parents=True, exist_ok=True)
    check_writable(out.parent)


def _record(figures: dict[str, list[Figure]], options: argparse.Namespace, machine: dict[str, Any]) -> dict[str, Any]:
    return {
        "command": options.command,
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": machine,
        "versions": package_versions(),
        "task": options.task,
        "rounds": options.rounds,
        "figures": {name: [asdict(figure) for figure in found] for name, found in figures.items()},
    }
