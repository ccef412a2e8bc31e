"""The folder argument of the commands on demonstrations, and how it is opened."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.tasks import add_own_task_argument
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.dataset_task import task_of
from dynaforge.options.paths import ExistingPath
from dynaforge.tasks import Task

OBSERVATIONS = "folder of `dynaforge render`; by default observations/ if there"
"""Help text of --observations in these commands."""


def add_dataset_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder and, for user-defined tasks, the option that names the file."""
    folder = ExistingPath("folder", containing="dataset.json", complaint="holds no demonstrations")
    parser.add_argument("folder", type=folder, help="folder of `dynaforge collect`")
    add_own_task_argument(parser)


def open_dataset(options: argparse.Namespace) -> tuple[DemonstrationDataset, Task]:
    """Open the folder for reading, with its task.

    Raises:
        ValueError: The task is user-defined and was not given, or another one was given.
    """
    dataset = DemonstrationDataset(options.folder)
    try:
        return dataset, task_of(dataset, options.task_file)
    except ValueError as error:
        raise ValueError(f"--task-file: {error}" if options.task_file else str(error)) from error
