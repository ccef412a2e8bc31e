"""`dynaforge list` and `dynaforge describe`: tasks and their descriptions."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.registration import ENV_NAMES, env_id
from dynaforge.reports.task_pages import description, write_task_pages
from dynaforge.tasks import get_task


def run(options: argparse.Namespace) -> int:
    """List all tasks, one per line, or describe some; with `--out`, write pages and pictures."""
    if "task" not in options:
        for name in ENV_NAMES:
            task = get_task(name)
            print(f"{name:<12} {env_id(name):<24} {task.skill:<16} {task.goal}")
        return 0
    tasks = chosen_tasks(options)
    if options.out is None:
        print("\n\n".join(description(task) for task in tasks))
        return 0
    for path in write_task_pages(tasks, options.out):
        print(f"written to {path}")
    return 0
