"""The vocabulary (phases, targets, predicates, conditions) and the tasks written in it."""

from __future__ import annotations

import difflib
import sys
import traceback
from importlib import import_module
from pathlib import Path
from types import ModuleType

from dynaforge.registration import ENV_NAMES, register_task
from dynaforge.tasks.conditions import STREAMS, ConditionSpace
from dynaforge.tasks.task import Mode, Phase, ResidualSpec, Task

__all__ = ["STREAMS", "TASK_NAMES", "ConditionSpace", "Mode", "Phase", "ResidualSpec", "Task", "get_task"]

TASK_NAMES = tuple(ENV_NAMES)
"""Every task: a module of this package with a `TASK`."""


def get_task(name: str) -> Task:
    """Return the task of that name, or the `TASK` of a file such as "ball.py".

    A task file is imported as a module of its own name, so that workers find it too, and its envs are registered.

    Raises:
        ValueError: No such task; a close match is named. Or the file holds none, cannot be run, or its name is taken.
    """
    if not isinstance(name, str):
        raise ValueError(f"No task {name!r}: give a task's name, such as 'can', or a task file, such as 'ball.py'.")
    if name.endswith(".py"):
        return _task_of_file(Path(name).resolve())
    if name not in TASK_NAMES:
        close = difflib.get_close_matches(name, TASK_NAMES, n=1)
        hint = f"Did you mean {close[0]!r}?" if close else f"Known are {', '.join(TASK_NAMES)}."
        raise ValueError(f"No task {name!r}. {hint}")
    task: Task = import_module(f"dynaforge.tasks.{name}").TASK
    return task


def _task_of_file(path: Path) -> Task:
    if not path.is_file():
        raise ValueError(f"No task file {str(path)!r}.")
    if "." in path.stem:
        raise ValueError(
            f"{path}: Python imports no file with a dot in its name; call it {path.stem.replace('.', '_')}.py."
        )
    if (known := sys.modules.get(path.stem)) is not None and getattr(known, "__file__", None) != str(path):
        raise ValueError(f"{path.name}: a module {path.stem!r} exists already; give the file another name.")
    if str(path.parent) not in sys.path:
        sys.path.insert(0, str(path.parent))
    task = getattr(_module_of_file(path), "TASK", None)
    if not isinstance(task, Task) or task.conditions.task != task.name:
        raise ValueError(f"{path} must define TASK, a Task whose conditions belong to it (ConditionSpace.task).")
    if task.name in TASK_NAMES:
        raise ValueError(f"{path}: the name {task.name!r} is that of a task of the package; choose another.")
    if task.name not in ENV_NAMES:
        if task.env_name in ENV_NAMES.values():
            raise ValueError(f"{path}: the env_name {task.env_name!r} is that of another task; choose another.")
        register_task(task.name, task.env_name, str(path))
    return task


def _module_of_file(path: Path) -> ModuleType:
    """Import a task file; whatever its code raises becomes one line with the file, the line and the reason."""
    try:
        return import_module(path.stem)
    except SyntaxError as error:
        line = f", line {error.lineno}" if error.lineno else ""
        raise ValueError(f"{error.filename or path}{line}: {error.msg}.") from error
    except (Exception, SystemExit) as error:  # a user's file may raise anything, and must not end the command
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        place = f"{path}, line {lines[-1]}" if lines else str(path)
        raise ValueError(f"{place}: {_in_one_line(error)}") from error


def _in_one_line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    if isinstance(error, SystemExit):
        return f"the file ends the program (SystemExit {text}); a task file only defines TASK."
    if isinstance(error, (ValueError, OSError)) and text:
        return text
    return f"{type(error).__name__}: {text}".removesuffix(": ")
