"""Registers the envs of every task with Gymnasium, by name only: nothing heavy is imported."""

from __future__ import annotations

from gymnasium.envs.registration import register

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


def env_id(task: str) -> str:
    """Return the residual env's id of a task, e.g. "DynaForge/Can-v0".

    Raises:
        ValueError: No such task.
    """
    if task not in ENV_NAMES:
        raise ValueError(f"No env for task {task!r}; known tasks are {', '.join(ENV_NAMES)}.")
    return f"DynaForge/{ENV_NAMES[task]}-v0"


def register_envs() -> None:
    """Register `DynaForge/<Task>-v0` and `DynaForge/<Task>Task-v0` of every task of the package."""
    for task in tuple(ENV_NAMES):
        register_task(task, ENV_NAMES[task], task)


def register_task(name: str, env_name: str, source: str) -> None:
    """Register the two envs of one task.

    Args:
        name: Lower-case name of the task.
        env_name: Its name in env ids.
        source: What the envs are made from: the name of a task of the package, or the path of a task file.
    """
    ENV_NAMES[name] = env_name
    register(f"DynaForge/{env_name}-v0", "dynaforge.envs.residual_env:ResidualEnv", kwargs={"task": source})
    register(f"DynaForge/{env_name}Task-v0", "dynaforge.envs.task_env:TaskEnv", kwargs={"task": source})
