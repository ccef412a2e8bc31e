"""User-defined tasks: files that define `TASK`, imported only where a user names them."""

from __future__ import annotations

import difflib
import os
import sys
import warnings
from pathlib import Path
from types import ModuleType

from dynaforge.registration import ENV_NAMES, TASK_FILES, TASK_FILES_VARIABLE, env_ids, register_task
from dynaforge.sim.checks import quoted
from dynaforge.tasks.task import Task
from dynaforge.tasks.user_code import module_of_file


def task_of_file(path: Path) -> Task:
    """Import a task file and register its envs.

    Raises:
        ValueError: The file does not exist, cannot be imported, defines no task, or uses a name that is taken.
    """
    if not path.is_file():
        raise ValueError(f"No task file {str(path)!r}.{_hint(path)}")
    module = module_of_file(path)
    try:
        task = _task_in(module, path)
        _register(task, path)
    except ValueError:
        del sys.modules[module.__name__]  # so that the file is read again once it is corrected
        raise
    return task


def _task_in(module: ModuleType, path: Path) -> Task:
    task = getattr(module, "TASK", None)
    if not isinstance(task, Task):
        others = [name for name, value in vars(module).items() if isinstance(value, Task)]
        if task is not None:
            problem = f"TASK is {quoted(task)}"
        elif others:
            problem = f"rename {others[0]} to TASK"
        else:
            problem = "the file defines none"
        raise ValueError(f"{path} must define TASK, a Task: {problem}.")
    return task


def _hint(path: Path) -> str:
    """Suggest a file beside the missing one, or a task of the package, that may have been meant."""
    neighbours = [other.name for other in path.parent.glob("*.py")] if path.parent.is_dir() else []
    close = difflib.get_close_matches(path.name, neighbours, n=1)
    close = close or difflib.get_close_matches(path.stem, ENV_NAMES, n=1)
    return f" Did you mean {close[0]!r}?" if close else ""


def register_listed_files() -> None:
    """Register the tasks whose files the environment variable DYNAFORGE_TASKS lists, under their names and env ids.

    A file that is missing or wrong is skipped with a warning, because importing the package must not fail for it.
    """
    for path in map(Path, _listed_files()):
        module = sys.modules.get(path.stem)
        if getattr(module, "__file__", None) == str(path) and not hasattr(module, "TASK"):
            continue  # the file itself has just imported this package
        try:
            task_of_file(path)
        except ValueError as error:
            warnings.warn(f"{TASK_FILES_VARIABLE} lists a file that is not a task file: {error}", stacklevel=2)


def _register(task: Task, path: Path) -> None:
    """Register the envs of a file's task, here and in processes that are started later."""
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
    os.environ[TASK_FILES_VARIABLE] = os.pathsep.join(dict.fromkeys((*_listed_files(), str(path))))


def _listed_files() -> list[str]:
    listed = os.environ.get(TASK_FILES_VARIABLE, "").split(os.pathsep)
    return [str(Path(path).expanduser().resolve()) for path in listed if path]
