"""The arguments that all commands on a folder of demonstrations share."""

from __future__ import annotations

import argparse
from pathlib import Path

from dynaforge.demos import DemonstrationDataset
from dynaforge.tasks import Task, get_task


def add_dataset_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder and, for tasks of one's own, their file."""
    parser.add_argument("folder", type=Path, help="folder of `dynaforge collect`")
    parser.add_argument("--task-file", help="file of the task, where it is one of your own")


def open_dataset(options: argparse.Namespace) -> tuple[DemonstrationDataset, Task]:
    """Open the folder for reading, with its task."""
    dataset = DemonstrationDataset(options.folder)
    return dataset, get_task(options.task_file or dataset.task)
