"""`dynaforge bench`: the project's figures of speed, exactness and limits, measured on this machine."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any

from dynaforge.benchmarks.figure import Figure
from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.files.atomic import atomic_write, check_writable
from dynaforge.files.versions import package_versions
from dynaforge.sampling.processes import usable_cores
from dynaforge.tasks import Task

QUIET_LOAD = 0.5  # processes waiting for a core, over a minute, up to which nothing else runs

Measurement = Callable[[Task, int], list[Figure]]


def _of(module: str) -> Any:
    """Import what measures when it is to measure: torch takes seconds."""
    return import_module(f"dynaforge.benchmarks.{module}")


MEASUREMENTS: dict[str, Measurement] = {
    "finger-speed": lambda task, rounds: _of("limits").finger_speed(task),
    "zero-residual": lambda task, rounds: _of("determinism").zero_residual(task),
    "one-trajectory": lambda task, rounds: _of("determinism").one_trajectory(task),
    "reset": lambda task, rounds: _of("speed").scene_reset(task, rounds=rounds),
    "control-steps": lambda task, rounds: _of("speed").control_rate(task, rounds=rounds),
    "vectorised": lambda task, rounds: _of("vector").vectorised(task, rounds=rounds),
    "trainer": lambda task, rounds: _of("training").trainer(task, rounds=rounds),
    "collection": lambda task, rounds: _of("training").collection(task, rounds=rounds),
    "writing": lambda task, rounds: _of("data").writing(task, rounds=rounds),
    "window": lambda task, rounds: _of("data").window(rounds=rounds),
    "replay": lambda task, rounds: _of("data").replay(task),
    "worker-killed": lambda task, rounds: _of("vector").worker_killed(task, rounds=min(rounds, 3)),
    "global-planner": lambda task, rounds: _of("limits").global_planner(task),
    "demonstrations": lambda task, rounds: _of("data").demonstrations(task),
}
"""What can be measured, by its name for `--only`, in the order of the table."""

LONG = frozenset({"demonstrations"})
"""What takes more than five minutes and is measured only when named."""


def run(options: argparse.Namespace) -> int:
    """Measure and print the table; returns 1 when a figure is missed, else 0.

    Raises:
        ValueError: An unknown task.
        OSError: `--out` cannot be written.
    """
    tasks = chosen_tasks(options)
    chosen = _chosen(options.only)
    if options.out is not None:
        _check_out(options.out)
    machine = _machine()
    if machine["load"] > QUIET_LOAD:
        print(f"note: the load is {machine['load']:.1f}; figures of speed hold only where nothing else runs")
    start, figures = time.monotonic(), dict[str, list[Figure]]()
    for number, (task, name) in enumerate(product(tasks, chosen), 1):
        what = name if len(tasks) == 1 else f"{task.name}: {name}"
        print(f"[{number}/{len(tasks) * len(chosen)}] {what}", file=sys.stderr, flush=True)
        found = MEASUREMENTS[name](task, options.rounds)
        figures[what] = found if len(tasks) == 1 else [replace(f, title=f"{task.name}: {f.title}") for f in found]
    print(table([figure for found in figures.values() for figure in found]))
    if options.out is not None:
        atomic_write(options.out, json.dumps(_record(figures, options, machine), indent=1).encode())
        print(f"\nwritten to {options.out}")
    missed = [name for name, found in figures.items() if not all(figure.ok for figure in found)]
    verdict = f"missed: {', '.join(missed)}" if missed else "every figure is met"
    print(f"\n{verdict}; took {time.monotonic() - start:.0f} s")
    return 1 if missed else 0


def table(figures: Sequence[Figure]) -> str:
    """Return the figures as a Markdown table."""
    rows = [f"| {f.title} | {f.target} | {f.measured} | {'yes' if f.ok else 'NO'} |" for f in figures]
    return "\n".join(["| figure | target | measured | ok |", "|---|---|---|---|", *rows])


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


def _machine() -> dict[str, Any]:
    """Describe processor, cores, and how busy the machine is before anything is measured."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    return {
        "cpu": model,
        "cores": usable_cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "load": round(os.getloadavg()[0], 2),
    }
