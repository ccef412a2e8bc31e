"""The digest of a task's definition: recordings with equal digests are of the same task."""

from __future__ import annotations

import functools
import hashlib
import inspect
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from types import FunctionType
from typing import Any
from xml.etree import ElementTree

import numpy as np

from dynaforge.sim.spec import asset_path
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.source import names_used, source_trees, tree_text
from dynaforge.tasks.task import ResidualSpec, Task

_known: dict[int, tuple[Task, tuple[str, str]]] = {}  # by id; the task is kept too, so that its id is not reused


def task_digest(task: Task) -> str:
    """Return 16 hex digits that identify a task's definition: its data, what its functions do, its URDFs.

    A function counts with the constants, functions and classes of its own module that it uses. Docstrings, comments,
    annotations and formatting do not count, in URDFs either. The camera, sentences and units are left out, because they
    only describe the task. So is the code of the vocabulary, which the package version identifies.
    """
    return _digests(task)[0]


def digest_in_any_setting(task: Task) -> str:
    """Return 16 hex digits that identify a task's definition but for its setting and the hidden ranges that follow."""
    return _digests(task)[1]


def definition_of(task: Task) -> dict[str, Any]:
    """Return plain JSON data that tells whether something made for a task is for this one: its digests, its setting."""
    whole, in_any_setting = _digests(task)
    return {"task_definition": whole, "in_any_setting": in_any_setting, "setting": task.setting.to_dict()}


def _digests(task: Task) -> tuple[str, str]:
    """Return the digest of a task's whole definition, and that of all but its setting."""
    if id(task) not in _known:
        in_any_setting = digest_of(task, "task")
        if task.lead_time:  # nothing is added without it, so that what was made before it counted is still accepted
            in_any_setting = digest_of((in_any_setting, task.lead_time), "lead time")
        whole = digest_of((in_any_setting, task.setting, task.conditions.hidden), "setting")
        _known[id(task)] = (task, (whole, in_any_setting))
    return _known[id(task)][1]


def digest_of(part: Any, name: str) -> str:
    """Return 16 hex digits that identify a named part of a definition: data, functions, or data with functions."""
    digest = hashlib.sha256()
    for each in _Parts().of(name, part):
        digest.update(each)
    return digest.hexdigest()[:16]


_EXCLUDED: dict[type, tuple[str, ...]] = {
    Task: ("camera", "motion", "randomisation", "goal", "instruction", "skill", "env_name", "setting", "lead_time"),
    ConditionSpace: ("units", "hidden"),
}
# Fields that count only where they are not the default, so that what was made before there were any is still accepted.
_ADDED: dict[type, tuple[str, ...]] = {ResidualSpec: ("history",)}
_PLAIN = (str, bytes, bool, int, float, np.generic, np.ndarray, tuple, list, Mapping, Enum, functools.partial)


class _Parts:
    """The bytes that identify a definition; each function and class counts once, where it is first met."""

    def __init__(self) -> None:
        self._met: set[Any] = set()

    def of(self, name: str, value: Any) -> Iterator[bytes]:
        """Yield the bytes of a named value."""
        yield f"\n{name}:".encode()
        if is_dataclass(value) and not isinstance(value, type):
            yield type(value).__name__.encode()
            if not _is_ours(type(value)):
                yield from self._code(type(value))
            for f in fields(value):
                part = getattr(value, f.name)
                added = f.name in _ADDED.get(type(value), ())
                if f.name not in _EXCLUDED.get(type(value), ()) and not (added and part == f.default):
                    yield from self.of(f.name, part)
        elif isinstance(value, Enum):
            yield value.name.encode()
        elif isinstance(value, Mapping):
            for key in value:
                yield from self.of(str(key), value[key])
        elif isinstance(value, (tuple, list)):
            for k, item in enumerate(value):
                yield from self.of(str(k), item)
        elif isinstance(value, np.ndarray):
            yield value.tobytes()
        elif isinstance(value, np.generic):
            yield repr(value.item()).encode()  # a scalar's own repr depends on the version of numpy
        elif isinstance(value, str) and value.endswith(".urdf"):
            yield ElementTree.canonicalize(from_file=asset_path(value), strip_text=True).encode()
        elif isinstance(value, functools.partial):
            yield from self.of("partial", (value.func, value.args, value.keywords))
        elif callable(value):
            yield from self._code(inspect.unwrap(value))
        else:
            yield repr(value).encode()

    def _code(self, thing: Any) -> Iterator[bytes]:
        """Yield what a function or class does, then what it uses from around it."""
        if not isinstance(thing, (FunctionType, type)):  # built in, or an object that can be called
            yield getattr(thing, "__qualname__", type(thing).__qualname__).encode()
            return
        if thing in self._met:
            yield thing.__name__.encode()
            return
        self._met.add(thing)
        try:
            trees = source_trees(thing)
        except (OSError, TypeError):  # defined at a prompt, or built in
            yield f"{thing.__module__}.{thing.__qualname__}".encode()
            return
        yield "".join(map(tree_text, trees)).encode()
        for name, value in names_used(thing, trees):
            if isinstance(value, (FunctionType, type)):
                counts = value.__module__ == thing.__module__
            else:
                counts = isinstance(value, _PLAIN) or (is_dataclass(value) and not isinstance(value, Task))
            if counts:
                yield from self.of(name, value)


def _is_ours(kind: type) -> bool:
    """Return whether a class is part of this package, whose version identifies it."""
    return kind.__module__.partition(".")[0] == "dynaforge"
