"""The env that a command line of rl_zoo3 means: our tasks may be given by name, env id or file."""

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
    """Import the packages of `--gym-packages`, as rl_zoo3 does; a module that is a task file registers its envs.

    Raises:
        ValueError: A package cannot be imported, or its task cannot be registered.
    """
    for package in packages:
        try:
            module = importlib.import_module(package)
        except ImportError as error:
            raise ValueError(f"--gym-packages {package}: {error}.") from error
        if isinstance(getattr(module, "TASK", None), Task) and module.__file__:
            get_task(module.__file__)


def named_env(given: str) -> str:
    """Return the env id that is meant: that of the residual env for a task's name or file; other envs as given.

    Raises:
        ValueError: A task file defines no task.
    """
    if given.endswith(".py"):
        return env_id(get_task(given).name)
    task = task_named(given)
    if task is None:
        return given
    bare = given.removeprefix("dynaforge:").lower()
    return next((env for env in env_ids(task) if env.lower() == bare), env_id(task))


def reading_our_settings(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Make rl_zoo3 read the entry of a zoo_configs file that `forge` and `compare` use."""

    def read_hyperparameters(manager: Any) -> Any:
        env_name = manager.env_name
        listed = yaml.safe_load(Path(manager.config).read_text(encoding="utf-8"))
        entry = entry_of(listed, env_name.gym_id)
        if entry in listed and entry != "default":
            manager.env_name = type(env_name)(entry)
        try:
            return read(manager)
        finally:
            manager.env_name = env_name

    return read_hyperparameters
