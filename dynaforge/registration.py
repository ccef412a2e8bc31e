"""Registers the envs of every task with Gymnasium, by name only: nothing heavy is imported."""

from __future__ import annotations

from pathlib import Path

from gymnasium.envs.registration import register, registry

ENV_NAMES = {
    "can": "Can",
    "bottle": "Bottle",
    "toycar": "ToyCar",
    "lemon": "Lemon",
    "alarmclock": "AlarmClock",
    "peach": "Peach",
    "block": "Block",
    "pen": "Pen",
    "peg": "Peg",
}
"""Task name to its name in env ids."""

TASK_FILES: dict[str, str] = {}
"""Path of the file of each task that is not one of the package."""

TASK_FILES_VARIABLE = "DYNAFORGE_TASKS"
"""The environment variable that lists task files, separated as in PATH. Users may set it, and workers inherit it."""


def env_id(task: str) -> str:
    """Return the residual env's id of a task, e.g. "DynaForge/Can-v0".

    Raises:
        ValueError: No such task.
    """
    if task not in ENV_NAMES:
        raise ValueError(f"No env for task {task!r}; known tasks are {', '.join(ENV_NAMES)}.")
    return f"DynaForge/{ENV_NAMES[task]}-v0"


def env_ids(task: str) -> tuple[str, str]:
    """Return both ids of a task: of its residual env and of the one with absolute actions."""
    return env_id(task), f"DynaForge/{ENV_NAMES[task]}Task-v0"


def task_named(given: str) -> str | None:
    """Return the registered task that a name, an env id, in whatever case, or a file means; None if there is none."""
    if given.endswith(".py"):
        return next((name for name, path in TASK_FILES.items() if path == str(Path(given).resolve())), None)
    bare = given.removeprefix("dynaforge:").lower()
    for name in ENV_NAMES:
        if bare in (text.lower() for text in (name, *env_ids(name))):
            return name
    return None


def register_envs() -> None:
    """Register `DynaForge/<Task>-v0` and `DynaForge/<Task>Task-v0` of every task of the package; once is enough.

    Called on `import dynaforge`, by an id with the module before it ("dynaforge:DynaForge/Can-v0"), and by what loads
    plugins of the group "gymnasium.envs".
    """
    for task in tuple(ENV_NAMES):
        if env_id(task) not in registry:
            register_task(task, ENV_NAMES[task], task)


def register_task(name: str, env_name: str, source: str) -> None:
    """Register the two envs of one task.

    Args:
        name: Lower-case name of the task.
        env_name: Its name in env ids.
        source: What the envs are made from: the name of a task of the package, or the path of a task file.
    """
    ENV_NAMES[name] = env_name
    if source != name:
        TASK_FILES[name] = source
    residual, absolute = env_ids(name)
    register(residual, "dynaforge.envs.residual_env:ResidualEnv", kwargs={"task": source})
    register(absolute, "dynaforge.envs.task_env:TaskEnv", kwargs={"task": source})
