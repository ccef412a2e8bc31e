"""The arguments that name a task: by its name, by the id of one of its envs, or by its file."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.setting import add_setting, chosen_parts
from dynaforge.options.refusal import Refused
from dynaforge.sim.checks import quoted
from dynaforge.tasks import TASK_NAMES, Task, get_task

LONGEST_PATH = 1000  # characters of a task file's path


def add_task_argument(
    parser: argparse.ArgumentParser,
    *flags: str,
    several: bool = False,
    default: str | None = "can",
    setting: bool = False,
) -> None:
    """Add the arguments that `chosen_tasks` or `chosen_task` reads.

    Args:
        parser: Parser of the command.
        flags: "--task", or "task" for a positional argument.
        several: Whether several tasks, or "all", may be named.
        default: The task if the flag is left out.
        setting: Whether the setting of the task may be chosen too.
    """
    if setting:
        add_setting(parser)
    known = f"{', '.join(TASK_NAMES)}; an env id of one; or a task file such as ball.py"
    if flags == ("task",):
        parser.add_argument("task", type=task_or_all, help=f"one of {known}; or all")
    elif several:
        parser.add_argument(
            *flags,
            dest="task",
            nargs="+",
            type=task_or_all,
            default=[default],
            metavar="TASK",
            help=f"some of {known}; or all",
        )
    else:
        parser.add_argument(*flags, dest="task", type=task, default=default, metavar="TASK", help=f"one of {known}")


def _in_setting(task: Task, options: argparse.Namespace) -> Task:
    """Return a task in the setting that was asked for; what was not is the task's own."""
    return task.under(**{name: getattr(options, name) for name in chosen_parts(options)})


def add_own_task_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the task of a folder of demonstrations, which is needed for user-defined tasks only."""
    parser.add_argument(
        "--task-file",
        "--task",
        dest="task_file",
        type=task,
        metavar="TASK",
        help="file of the task (its code is run), where it is one of your own",
    )


def task(text: str) -> str:
    """Check that a task exists, and return the text that names it.

    Raises:
        argparse.ArgumentTypeError: The task does not exist.
    """
    if len(text) > LONGEST_PATH or "\0" in text:
        raise Refused(f"is {quoted(text)}; it must be a task's name, an env id or a task file.")
    try:
        get_task(text)
    except (ValueError, OSError) as error:
        raise Refused(f": {error}") from error
    return text


def task_or_all(text: str) -> str:
    """Return "all", or what `task` returns."""
    return text if text == "all" else task(text)


def chosen_task(options: argparse.Namespace) -> Task:
    """Return the task that was asked for.

    Raises:
        ValueError: There is no such task.
    """
    return _in_setting(get_task(options.task), options)


def chosen_tasks(options: argparse.Namespace) -> list[Task]:
    """Return the tasks that were asked for, in that order; for "all" those of the package.

    Raises:
        ValueError: A task does not exist, or was named twice, in whatever form.
    """
    given = [options.task] if isinstance(options.task, str) else options.task
    tasks = [_in_setting(get_task(name), options) for name in (TASK_NAMES if given == ["all"] else given)]
    names = [task.name for task in tasks]
    if twice := [text for text, name in zip(given, names, strict=False) if names.count(name) > 1]:
        raise ValueError(f"{' and '.join(twice)} are one and the same task; ask for it once.")
    return tasks
