"""Tasks of one's own: files that define `TASK`, imported only where a user names them."""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from importlib import import_module
from pathlib import Path
from types import ModuleType

from dynaforge.registration import ENV_NAMES, TASK_FILES, env_ids, register_task
from dynaforge.tasks.task import Task

VARIABLE = "DYNAFORGE_TASKS"
"""Environment variable that lists task files, separated as in PATH: a user may set it, and workers inherit it."""


def task_of_file(path: Path) -> Task:
    """Import a task file and register its envs.

    Raises:
        ValueError: There is no such file, it cannot be run, defines no task, or takes a name that is taken.
    """
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
    _register(task, path)
    return task


def register_listed_files() -> None:
    """Make the tasks known whose files the environment variable DYNAFORGE_TASKS lists, by name and env ids.

    A file that is missing or wrong is skipped with a warning: importing the package must not fail for it.
    """
    for path in map(Path, _listed_files()):
        under_way = sys.modules.get(path.stem)
        if getattr(under_way, "__file__", None) == str(path) and not hasattr(under_way, "TASK"):
            continue  # the file itself has just imported this package
        try:
            task_of_file(path)
        except ValueError as error:
            warnings.warn(f"{VARIABLE} lists a file that is no task: {error}", stacklevel=2)


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


def _register(task: Task, path: Path) -> None:
    """Register the envs of a file's task, here and in processes that will be started."""
    if (other := TASK_FILES.get(task.name)) is not None:
        if other != str(path):
            raise ValueError(f"{path}: the name {task.name!r} is that of the task in {other}; choose another.")
        return
    if task.name in ENV_NAMES:
        raise ValueError(f"{path}: the name {task.name!r} is that of a task of the package; choose another.")
    taken = {env.lower() for name in ENV_NAMES for env in env_ids(name)}
    if any(f"dynaforge/{task.env_name}{kind}-v0".lower() in taken for kind in ("", "Task")):
        raise ValueError(f"{path}: the env_name {task.env_name!r} makes an env id of another task; choose another.")
    register_task(task.name, task.env_name, str(path))
    os.environ[VARIABLE] = os.pathsep.join(dict.fromkeys((*_listed_files(), str(path))))


def _listed_files() -> list[str]:
    listed = os.environ.get(VARIABLE, "").split(os.pathsep)
    return [str(Path(path).expanduser().resolve()) for path in listed if path]
