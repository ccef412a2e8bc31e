"""The vocabulary (phases, targets, predicates, conditions) and the tasks written in it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

from dynaforge.registration import ENV_NAMES, TASK_FILES, env_ids, task_named
from dynaforge.sim.checks import quoted
from dynaforge.tasks.conditions import STREAMS, ConditionSpace
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
    "Task",
    "get_task",
    "task_file_name",
    "task_source",
    "what_was_meant",
]

TASK_NAMES = tuple(name for name in ENV_NAMES if name not in TASK_FILES)
"""Every task of the package: a module here with a `TASK`."""


def get_task(given: str) -> Task:
    """Return a task by its name, by the id of one of its envs, or by its file such as "ball.py".

    A task file is imported as a module of its own name, so that workers find it too, and its envs are registered: from
    then on the task's name and ids stand for the file, here and in processes that are started later. Importing runs
    the code in it, so never pass a path that was read from somebody's data.

    Args:
        given: "can", "DynaForge/Can-v0", "DynaForge/CanTask-v0", either with "dynaforge:" before it, in whatever case;
            or a path that ends in ".py".

    Raises:
        ValueError: No such task; a close match is named. Or the file holds none, cannot be run, or its name is taken.
    """
    if not isinstance(given, str):
        raise ValueError(
            f"No task {quoted(given)}: give a task's name, such as 'can', or a task file, such as 'ball.py'."
        )
    if given.endswith(".py"):
        return task_of_file(Path(given).resolve())
    name = task_named(given)
    if name is None:
        raise ValueError(f"No task {given!r}. {what_was_meant(given)}")
    if name in TASK_FILES:
        return task_of_file(Path(TASK_FILES[name]))
    task: Task = import_module(f"dynaforge.tasks.{name}").TASK
    return task


def task_source(task: Task) -> str:
    """Return what names a task in any process, for `get_task` and `TaskEnv`: its name, or the path of its file."""
    return TASK_FILES.get(task.name, task.name)


def task_file_name(task: Task) -> str:
    """Return the name of the file that a task of one's own came from, without its folders; "" for any other."""
    return Path(TASK_FILES.get(task.name, "")).name


def what_was_meant(given: str, *, among: Iterable[str] = ()) -> str:
    """Say what may have been meant by a task that does not exist; or by an env, if ids are given to look among."""
    known = {text.lower(): text for name in ENV_NAMES for text in (name, *env_ids(name))}
    known |= {text.lower(): text for text in among}
    bare = given.removeprefix("dynaforge:").lower()
    stem = bare.removeprefix("dynaforge/").removesuffix("-v0")
    files = [name for name in (f"{stem}.py", f"{stem.removesuffix('task')}.py") if Path(name).is_file()]
    if files:
        return f"If you mean the task of {files[0]}, give that file in its place."
    close = difflib.get_close_matches(bare, known, n=1)
    if close:
        return f"Did you mean {known[close[0]]!r}?"
    return f"Known are {', '.join(ENV_NAMES)}, the ids of their envs, and files such as ball.py."
