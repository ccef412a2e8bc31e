"""The words of a phase program, its targets and predicates: evaluated and checked, with messages about mistakes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim.checks import check_numbers, close_match, is_number, quoted
from dynaforge.tasks.view import PhaseView

Size = float  # a field of a word with this annotation must be 0 or more
ObjectName = str  # a field of a word with this annotation, or called `object`, names a body or a fixture of the scene


def evaluate_predicate(place: str, role: str, predicate: Callable[..., Any], view: PhaseView, target: Pose) -> bool:
    """Return whether a predicate holds.

    Args:
        place: Where the predicate is used, such as "Phase 'track'".
        role: What it is used for there, such as "done".
        predicate: The predicate.
        view: The scene.
        target: The phase's current target `T_world_ee`.

    Raises:
        ValueError: The predicate raises, or returns neither True nor False; names place, role and predicate.
    """
    try:
        value = predicate(view, target)
        if not isinstance(value, (bool, np.bool_)):
            raise TypeError(f"it returns {quoted(value)}, neither True nor False")
    except Exception as error:  # user code may raise anything
        raise ValueError(_error_message(place, role, predicate, view, error)) from error
    return bool(value)


def evaluate_target(place: str, target: Callable[..., Any], view: PhaseView) -> Pose:
    """Return the pose that a target asks for.

    Args:
        place: Where the target is used, such as "Phase 'track'".
        target: The target.
        view: The scene.

    Raises:
        ValueError: The target raises, or does not return a Pose of finite numbers; names place and target.
    """
    try:
        pose = target(view)
        if not isinstance(pose, Pose):
            raise TypeError(f"it returns {quoted(pose)}, which is not a Pose")
        if not math.isfinite(np.vdot(pose.position, pose.position) + np.vdot(pose.rotation, pose.rotation)):
            raise ValueError(f"it returns {quoted(pose)}, which is not finite")
    except Exception as error:  # user code may raise anything
        raise ValueError(_error_message(place, "target", target, view, error)) from error
    return pose


def _error_message(place: str, role: str, word: object, view: PhaseView, error: Exception) -> str:
    state = view.state
    key = error.args[0] if isinstance(error, KeyError) and error.args else None
    if isinstance(key, str) and key not in state.objects:
        return unknown_name_message(place, f"names {key!r} in {role}, {quoted(word)}", key, state.objects)
    if isinstance(key, str):
        return (
            f"{place}: {role}, {quoted(word)}, reads what is not measured of {key!r}: on_table is measured of free "
            f"bodies ({_listed(state.on_table)}), pressed of fixtures with a spring ({_listed(state.pressed)})."
        )
    return f"{place}: {role}, {quoted(word)}, raised {type(error).__name__}: {error}."


def unknown_name_message(place: str, clause: str, name: object, known: Mapping[str, Any] | tuple[str, ...]) -> str:
    """Return the message that the scene has no object of a name, with the name that was probably meant.

    Args:
        place: Where the name is used, such as "Phase 'track'".
        clause: The predicate of the sentence about `place`, such as "aims at 'cann'".
        name: The unknown name.
        known: The names of the scene.
    """
    return f"{place} {clause}; the scene has {_listed(known)}.{close_match(name, known)}"


def _listed(names: Mapping[str, Any] | tuple[str, ...]) -> str:
    return ", ".join(map(repr, names)) or "none"


def check_word(place: str, role: str, word: object, names: tuple[str, ...]) -> None:
    """Check the fields of a word and of all words inside it: sizes, choices, numbers, names of objects.

    Args:
        place: Where the word is used, such as "Phase 'track'".
        role: What it is used for there, such as "done".
        word: The word; of one that is not a dataclass nothing can be checked.
        names: The bodies and fixtures of the scene.

    Raises:
        ValueError: A value of the wrong type or out of range, or the name of an object that the scene lacks.
    """
    for part in _parts(word):
        for field in fields(part):  # type: ignore[arg-type]
            value = getattr(part, field.name)
            _check_value(f"{place}: {role}, {type(part).__name__}: {field.name}", field, value)
            if (_annotation(field) == "ObjectName" or field.name == "object") and value not in names:
                clause = f"names {quoted(value)} in {role}, {quoted(part)}"
                raise ValueError(unknown_name_message(place, clause, value, names))


def _check_value(name: str, field: Field[Any], value: Any) -> None:
    """Check that a field's value fits its annotation, or the enum that its default is a member of."""
    kind = _annotation(field)
    is_size = kind.startswith("Size")  # or "Size | None"
    if (kind in ("float", "Size") or (is_size and value is not None)) and not is_number(value):
        raise ValueError(f"{name} is {quoted(value)}; it must be a number.")
    if is_number(value) and is_size and not value >= 0:
        raise ValueError(f"{name} is {quoted(value)}; it must be a number of at least 0.")
    if is_number(value) and math.isnan(value):
        raise ValueError(f"{name} is {quoted(value)}; it must be a number.")
    if kind == "tuple[float, float, float]":
        check_numbers(name, value, 3)
    if isinstance(field.default, Enum) and not isinstance(value, type(field.default)):
        raise ValueError(f"{name} is {quoted(value)}; it must be a {kind}, such as {field.default!s}.")


def _annotation(field: Field[Any]) -> str:
    return field.type if isinstance(field.type, str) else field.type.__name__


def _parts(word: object, parents: tuple[object, ...] = ()) -> Iterator[object]:
    """Iterate over the dataclasses among a word and all that it contains; `parents` are what it is contained in."""
    if any(word is parent for parent in parents):
        return  # contains itself
    children: list[object] = []
    if isinstance(word, (tuple, list)):
        children = list(word)
    elif isinstance(word, type):
        pass
    elif is_dataclass(word):
        yield word
        children = [getattr(word, field.name) for field in fields(word)]
    elif callable(word) and hasattr(word, "__dict__"):
        children = list(vars(word).values())
    for child in children:
        yield from _parts(child, (*parents, word))
