"""The vocabulary of tasks (phases, targets, predicates, conditions) and the tasks written in it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

from dynaforge.registration import ENV_NAMES, TASK_FILES, env_ids, task_named
from dynaforge.sim.checks import quoted
from dynaforge.tasks.conditions import STREAMS, ConditionSpace, Stream
from dynaforge.tasks.outcome import Outcome
from dynaforge.tasks.task import FRAMES, Frame, Mode, Phase, ResidualSpec, Task
from dynaforge.tasks.task_file import task_of_file

__all__ = [
    "FRAMES",
    "STREAMS",
    "TASK_NAMES",
    "ConditionSpace",
    "Frame",
    "Mode",
    "Outcome",
    "Phase",
    "ResidualSpec",
    "Stream",
    "Task",
    "get_task",
    "suggestion",
    "task_file_name",
    "task_source",
]

TASK_NAMES = tuple(name for name in ENV_NAMES if name not in TASK_FILES)
"""The tasks of the package: each is a module here that defines `TASK`."""


def get_task(given: str) -> Task:
    """Return a task by its name, by the id of one of its envs, or by the path of its file, such as "ball.py".

    A task file is imported as a module named after the file, so that workers find it too, and its envs are registered:
    from then on the task's name and env ids work in place of the path, here and in processes that are started later.
    Importing runs the code in the file, so never pass a path that was read from somebody else's data.

    Args:
        given: A name such as "can"; an env id such as "DynaForge/Can-v0" or "DynaForge/CanTask-v0", with or without
            "dynaforge:" in front, in upper or lower case; or a path that ends in ".py".

    Raises:
        ValueError: There is no such task (the message names a close match), or the file defines none, cannot be
            imported, or uses a name that is taken.
    """
    if not isinstance(given, str):
        raise ValueError(
            f"No task {quoted(given)}: give a task's name, such as 'can', or a task file, such as 'ball.py'."
        )
    if given.endswith(".py"):
        return task_of_file(Path(given).resolve())
    name = task_named(given)
    if name is None:
        raise ValueError(f"No task {given!r}. {suggestion(given)}")
    if name in TASK_FILES:
        return task_of_file(Path(TASK_FILES[name]))
    task: Task = import_module(f"dynaforge.tasks.{name}").TASK
    return task


def task_source(task: Task) -> str:
    """Return the string by which `get_task` finds a task in any process: its name, or the path of its file."""
    return TASK_FILES.get(task.name, task.name)


def task_file_name(task: Task) -> str:
    """Return the file name, without folders, of a user-defined task; "" for a task of the package."""
    return Path(TASK_FILES.get(task.name, "")).name


def suggestion(given: str, *, among: Iterable[str] = ()) -> str:
    """Return a sentence that says which task or env was probably meant by a name that does not exist.

    Args:
        given: The name.
        among: Further env ids to compare it with.
    """
    known = {text.lower(): text for name in ENV_NAMES for text in (name, *env_ids(name))}
    known |= {text.lower(): text for text in among}
    name = given.removeprefix("dynaforge:").lower()
    stem = name.removeprefix("dynaforge/").removesuffix("-v0")
    files = [file for file in (f"{stem}.py", f"{stem.removesuffix('task')}.py") if Path(file).is_file()]
    if files:
        return f"If you mean the task in {files[0]}, give that file instead."
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"Did you mean {known[close[0]]!r}?"
    return f"Known tasks are {', '.join(ENV_NAMES)}; the ids of their envs and files such as ball.py work too."
