"""What is asked of the words of a program, targets and predicates, and what a mistake in one of them is called."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim.checks import check_numbers, close_match, is_number, quoted
from dynaforge.tasks.view import PhaseView

Size = float  # a field of a word annotated so is 0 or more
ObjectName = str  # a field of a word annotated so, or called `object`, names a body or a fixture of the scene


def judge(place: str, role: str, predicate: Callable[..., Any], view: PhaseView, target: Pose) -> bool:
    """Return what a predicate says of a view.

    Args:
        place: Where it stands, such as "Phase 'track'".
        role: What it is there, such as "done".
        predicate: The predicate.
        view: The scene.
        target: The phase's current target `T_world_ee`.

    Raises:
        ValueError: It raises, or says neither True nor False; names place, role and predicate.
    """
    try:
        held = predicate(view, target)
        if not isinstance(held, (bool, np.bool_)):
            raise TypeError(f"it says {quoted(held)}, neither True nor False")
    except Exception as error:  # a task's own code: whatever it raises is told with its place
        raise ValueError(_told(place, role, predicate, view, error)) from error
    return bool(held)


def aim(place: str, target: Callable[..., Any], view: PhaseView) -> Pose:
    """Return the pose that a target makes of a view.

    Raises:
        ValueError: It raises, or returns no pose of finite numbers; names place and target.
    """
    try:
        pose = target(view)
        if not isinstance(pose, Pose):
            raise TypeError(f"it returns {quoted(pose)}, no Pose")
        if not math.isfinite(np.vdot(pose.position, pose.position) + np.vdot(pose.rotation, pose.rotation)):
            raise ValueError(f"it returns {quoted(pose)}, which is not finite")
    except Exception as error:  # a task's own code: whatever it raises is told with its place
        raise ValueError(_told(place, "target", target, view, error)) from error
    return pose


def _told(place: str, role: str, word: object, view: PhaseView, error: Exception) -> str:
    state = view.state
    key = error.args[0] if isinstance(error, KeyError) and error.args else None
    if isinstance(key, str) and key not in state.objects:
        return unknown(place, f"speaks of {key!r} in {role}, {quoted(word)}", key, state.objects)
    if isinstance(key, str):
        return (
            f"{place}: {role}, {quoted(word)}, asks of {key!r} what is not measured of it: on_table is of free bodies "
            f"({_listed(state.on_table)}), pressed of fixtures with a spring ({_listed(state.pressed)})."
        )
    return f"{place}: {role}, {quoted(word)}, raised {type(error).__name__}: {error}."


def unknown(place: str, does: str, name: object, known: Mapping[str, Any] | tuple[str, ...]) -> str:
    """Say that a name is none of the scene's, and what was probably meant."""
    return f"{place} {does}; the scene has {_listed(known)}.{close_match(name, known)}"


def _listed(names: Mapping[str, Any] | tuple[str, ...]) -> str:
    return ", ".join(map(repr, names)) or "none"


def check_word(place: str, role: str, word: object, names: tuple[str, ...]) -> None:
    """Check the data of a word and of the words in it, however deep: sizes, choices, numbers, names of objects.

    Args:
        place: Where it stands, such as "Phase 'track'".
        role: What it is there, such as "done".
        word: The word; of one that is no dataclass nothing is known.
        names: The bodies and fixtures of the scene.

    Raises:
        ValueError: A value that can mean nothing, or the name of an object that the scene lacks.
    """
    for part in _parts(word):
        for field in fields(part):  # type: ignore[arg-type]
            value = getattr(part, field.name)
            kind = field.type if isinstance(field.type, str) else field.type.__name__
            what = f"{place}: {role}, {type(part).__name__}: {field.name}"
            sized = kind.startswith("Size")  # or "Size | None"
            if (kind in ("float", "Size") or (sized and value is not None)) and not is_number(value):
                raise ValueError(f"{what} is {quoted(value)}; it must be a number.")
            if is_number(value) and (math.isnan(value) or (sized and value < 0)):
                raise ValueError(f"{what} is {quoted(value)}; it must be a number{' of at least 0' * sized}.")
            if kind == "tuple[float, float, float]":
                check_numbers(what, value, 3)
            if isinstance(field.default, Enum) and not isinstance(value, type(field.default)):
                raise ValueError(f"{what} is {quoted(value)}; it must be a {kind}, such as {field.default!s}.")
            if (kind == "ObjectName" or field.name == "object") and value not in names:
                raise ValueError(unknown(place, f"speaks of {quoted(value)} in {role}, {quoted(part)}", value, names))


def _parts(word: object, above: tuple[object, ...] = ()) -> Iterator[object]:
    """Iterate over the dataclasses among a word and all that it is composed of; `above` is what it is part of."""
    if any(word is other for other in above):
        return
    if isinstance(word, (tuple, list)):
        inside = list(word)
    elif isinstance(word, type):
        inside = []
    elif is_dataclass(word):
        yield word
        inside = [getattr(word, field.name) for field in fields(word)]
    else:
        inside = list(vars(word).values()) if callable(word) and hasattr(word, "__dict__") else []
    for item in inside:
        yield from _parts(item, (*above, word))
