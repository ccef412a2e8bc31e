"""The vocabulary (phases, targets, predicates, conditions) and the tasks written in it."""

from __future__ import annotations

import difflib
from importlib import import_module

from dynaforge.registration import ENV_NAMES
from dynaforge.tasks.conditions import STREAMS, ConditionSpace
from dynaforge.tasks.task import Mode, Phase, ResidualSpec, Task

__all__ = ["STREAMS", "TASK_NAMES", "ConditionSpace", "Mode", "Phase", "ResidualSpec", "Task", "get_task"]

TASK_NAMES = tuple(ENV_NAMES)
"""Every task: a module of this package with a `TASK`."""


def get_task(name: str) -> Task:
    """Return the task of that name.

    Raises:
        ValueError: No such task; a close match is named.
    """
    if name not in TASK_NAMES:
        close = difflib.get_close_matches(name, TASK_NAMES, n=1)
        hint = f"Did you mean {close[0]!r}?" if close else f"Known are {', '.join(TASK_NAMES)}."
        raise ValueError(f"No task {name!r}. {hint}")
    task: Task = import_module(f"dynaforge.tasks.{name}").TASK
    return task
