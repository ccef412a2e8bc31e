"""Which env a command line of rl_zoo3 means, where our tasks may be named by name, env id or file."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import yaml

from dynaforge.registration import env_id, env_ids, task_named
from dynaforge.tasks import Task, get_task
from dynaforge.training.settings import entry_of


def import_packages(packages: Iterable[str]) -> None:
    """Import what `--gym-packages` names, as rl_zoo3 does; a module that is a task file registers its envs.

    Raises:
        ValueError: One cannot be imported, or its task not registered.
    """
    for package in packages:
        try:
            module = importlib.import_module(package)
        except ImportError as error:
            raise ValueError(f"--gym-packages {package}: {error}.") from error
        if isinstance(getattr(module, "TASK", None), Task) and module.__file__:
            get_task(module.__file__)


def named_env(given: str) -> str:
    """Return the env id that is meant: for a task's name or file its residual env's; what is not ours as it is.

    Raises:
        ValueError: A task file holds no task.
    """
    if given.endswith(".py"):
        return env_id(get_task(given).name)
    task = task_named(given)
    if task is None:
        return given
    bare = given.removeprefix("dynaforge:").lower()
    return next((env for env in env_ids(task) if env.lower() == bare), env_id(task))


def reading_our_settings(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Let rl_zoo3's reading of a file of zoo_configs take the entry that `forge` and `compare` take."""

    def read_hyperparameters(manager: Any) -> Any:
        asked = manager.env_name
        listed = yaml.safe_load(Path(manager.config).read_text(encoding="utf-8"))
        entry = entry_of(listed, asked.gym_id)
        if entry in listed and entry != "default":
            manager.env_name = type(asked)(entry)
        try:
            return read(manager)
        finally:
            manager.env_name = asked

    return read_hyperparameters
