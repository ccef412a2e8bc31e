"""Checks at the door of the envs: one line that names what is wrong, before any work."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynaforge.sim import Condition
from dynaforge.tasks import Task


def check_choice(name: str, value: str | None, known: tuple[str | None, ...]) -> None:
    """Raise ValueError unless `value` is one of `known`."""
    if value not in known:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, known))}; got {value!r}.")


def condition_from_options(task: Task, options: dict[str, Any] | None, rng: np.random.Generator) -> Condition:
    """Read the condition from reset options, or draw one.

    Raises:
        ValueError: An unknown option, or a condition that is not this task's.
    """
    options = options or {}
    if unknown := sorted(set(options) - {"condition"}):
        raise ValueError(f"Unknown reset options {unknown}; the one known is 'condition'.")
    condition = options.get("condition")
    if condition is None:
        return task.conditions.draw(rng)
    if isinstance(condition, dict):
        condition = Condition.from_dict(condition)
    if not isinstance(condition, Condition):
        raise ValueError(f"options['condition'] must be a Condition or its dict, got {type(condition).__name__}.")
    return task.conditions.validate(condition)
