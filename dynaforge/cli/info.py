"""`dynaforge info`: what a folder of demonstrations contains, at a glance."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos.prescription import describe_dynamics
from dynaforge.demos.untrusted import printable
from dynaforge.reports.dataset_summary import attempt_tables, recording_summary


def run(options: argparse.Namespace) -> int:
    """Print counts, rates, lengths, ranges and size."""
    dataset, task = open_dataset(options)
    attempts, episodes = dataset.attempts(), list(dataset)
    size = sum(path.stat().st_size for path in options.folder.rglob("*") if path.is_file())
    counts = f"{len(episodes)} recordings of {len(attempts)} attempts, {size / 1e6:.1f} MB"
    _print(f"{options.folder}: {task.env_name}, {counts}")
    _print(f"setting: {task.setting}")
    if said := describe_dynamics(attempt.dynamics for attempt in attempts):
        _print(f"dynamics: {said}")
    for table in attempt_tables(attempts, task):
        _print(f"\n{table}")
    if attempts and episodes:
        _print(f"\n{recording_summary(episodes, task)}")
    return 0


def _print(text: str) -> None:
    """Print lines with control characters escaped, since reasons and names may come from a stranger."""
    print("\n".join(map(printable, text.split("\n"))))
