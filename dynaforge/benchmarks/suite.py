"""The list of measurements, the table of their figures, and the description of the machine."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from dynaforge.benchmarks.figure import Figure
from dynaforge.sampling.processes import usable_cores
from dynaforge.tasks import Task

QUIET_LOAD = 0.5  # load average of the last minute up to which the machine counts as idle

Measurement = Callable[[Task, int], list[Figure]]


def _of(module: str) -> Any:
    """Import a module of this package only when it is used, because torch takes seconds."""
    return import_module(f"dynaforge.benchmarks.{module}")


MEASUREMENTS: dict[str, Measurement] = {
    "finger-speed": lambda task, rounds: _of("hand").finger_speed(task),
    "hand": lambda task, rounds: _of("hand").hand(task),
    "peak-force": lambda task, rounds: _of("forces").peak_force(task),
    "reflex": lambda task, rounds: _of("forces").reflex(task, rounds=rounds),
    "speed-limits": lambda task, rounds: _of("limits").speed_limits(task),
    "zero-residual": lambda task, rounds: _of("determinism").zero_residual(task),
    "one-trajectory": lambda task, rounds: _of("determinism").one_trajectory(task),
    "reset": lambda task, rounds: _of("speed").scene_reset(task, rounds=rounds),
    "global-plans": lambda task, rounds: _of("speed").global_plans(task),
    "control-steps": lambda task, rounds: _of("speed").control_rate(task, rounds=rounds),
    "control-steps-plain": lambda task, rounds: _of("speed").control_rate(task, rounds=rounds, plain=True),
    "vectorised": lambda task, rounds: _of("vector").vectorised(task, rounds=rounds),
    "prefix": lambda task, rounds: _of("prefix").shared_prefix(),
    "trainer": lambda task, rounds: _of("training").trainer(task, rounds=rounds),
    "collection": lambda task, rounds: _of("training").collection(task, rounds=rounds),
    "writing": lambda task, rounds: _of("data").writing(task, rounds=rounds),
    "window": lambda task, rounds: _of("data").window(rounds=rounds),
    "replay": lambda task, rounds: _of("data").replay(task),
    "worker-killed": lambda task, rounds: _of("vector").worker_killed(task, rounds=min(rounds, 3)),
    "global-planner": lambda task, rounds: _of("limits").global_planner(task),
    "demonstrations": lambda task, rounds: _of("data").demonstrations(task),
}
"""The measurements by their names for `--only`, in the order of the table."""

LONG = frozenset({"demonstrations"})
"""Measurements that take more than five minutes, and are made only when named."""


def table(figures: Sequence[Figure]) -> str:
    """Return the figures as a Markdown table."""
    rows = [f"| {f.title} | {f.target} | {f.measured} | {'yes' if f.ok else 'NO'} |" for f in figures]
    return "\n".join(["| figure | target | measured | ok |", "|---|---|---|---|", *rows])


def describe_machine() -> dict[str, Any]:
    """Return processor, cores, system, and how busy the machine is before anything is measured."""
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
