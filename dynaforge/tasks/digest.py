"""The digest of a task's definition: recordings with equal digests are of the same task."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from dynaforge.sim.spec import asset_path
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.task import Task

_known: dict[int, tuple[Task, str]] = {}  # by id; the task is kept too, so that its id is not reused


def task_digest(task: Task) -> str:
    """Return 16 hex digits that identify a task's definition: its data, the source of its functions, its URDFs.

    The camera, sentences and units are left out, because they only describe the task. So is the code of the
    vocabulary, which the package version identifies.
    """
    if id(task) not in _known:
        digest = hashlib.sha256()
        for part in _parts("task", task):
            digest.update(part)
        _known[id(task)] = (task, digest.hexdigest()[:16])
    return _known[id(task)][1]


def definition_of(task: Task) -> dict[str, Any]:
    """Return plain JSON data that tells whether something made for a task is for this one: its digest, its setting."""
    return {"task_definition": task_digest(task), "setting": task.setting.to_dict()}


_EXCLUDED: dict[type, tuple[str, ...]] = {
    Task: ("camera", "motion", "randomisation", "goal", "instruction", "skill", "env_name"),
    ConditionSpace: ("units",),
}


def _parts(name: str, value: Any) -> Iterator[bytes]:
    yield f"\n{name}:".encode()
    if is_dataclass(value) and not isinstance(value, type):
        yield type(value).__name__.encode()
        for f in fields(value):
            if f.name not in _EXCLUDED.get(type(value), ()):
                yield from _parts(f.name, getattr(value, f.name))
    elif isinstance(value, Enum):
        yield value.name.encode()
    elif isinstance(value, Mapping):
        for key in value:
            yield from _parts(str(key), value[key])
    elif isinstance(value, (tuple, list)):
        for k, item in enumerate(value):
            yield from _parts(str(k), item)
    elif isinstance(value, np.ndarray):
        yield value.tobytes()
    elif isinstance(value, str) and value.endswith(".urdf"):
        yield asset_path(value).read_bytes()
    elif callable(value):
        yield _source(value).encode()
    else:
        yield repr(value).encode()


def _source(function: Any) -> str:
    try:
        return inspect.getsource(function)
    except (OSError, TypeError):  # defined at a prompt, or built in
        return f"{function.__module__}.{function.__qualname__}"
