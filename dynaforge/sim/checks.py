"""Checks of what a caller passes: a refusal names the thing, the value, what was expected and what to do."""

from __future__ import annotations

import difflib
import math
import re
import reprlib
import sys
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynaforge.geometry import Array, Pose

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_IN_WORDS = {"str": "text", "Mapping": "mapping"}
_CONTROL = re.compile(r"[\x00-\x1f\x7f\x85\u2028\u2029]")  # breaks of lines among them
_RESERVED = ("all",)  # as a task's name on the command line
_SPELLING = reprlib.Repr()
_SPELLING.maxstring = _SPELLING.maxother = _SPELLING.maxlong = 80


def quoted(value: Any) -> str:
    """Spell a value out for a message, on one line and cut short."""
    try:
        text = " ".join(_SPELLING.repr(value).split())
        return re.sub(r" at 0x[0-9a-f]+", "", text)  # which differs from process to process
    except ValueError:  # Python spells out no whole number of more than 4300 digits
        return f"a very large {type(value).__name__}"


def close_match(name: Any, known: Iterable[str]) -> str:
    """Return a sentence that names what was probably meant, or nothing."""
    spelled = {other.lower(): other for other in known}
    close = difflib.get_close_matches(name.lower(), spelled, n=1) if isinstance(name, str) else []
    return f" Did you mean {spelled[close[0]]!r}?" if close else ""


def check_number(
    what: str, value: Any, *, least: float = -math.inf, most: float = math.inf, above: float = -math.inf
) -> None:
    """Raise ValueError unless the value is a finite number with `least` <= value <= `most` and value > `above`."""
    good = is_number(value) and abs(value) < math.inf and least <= value <= most and value > above
    if not good:
        bounds = [f"above {above:g}"] if above > -math.inf else [f"of at least {least:g}"] if least > -math.inf else []
        bounds += [f"at most {most:g}"] if most < math.inf else []
        raise ValueError(f"{what} is {quoted(value)}; it must be a finite number {' and '.join(bounds)}".rstrip() + ".")


def check_whole(what: str, value: Any, *, least: int) -> None:
    """Raise ValueError unless the value is a whole number of at least `least`."""
    if not is_whole(value) or value < least:
        raise ValueError(f"{what} is {quoted(value)}; it must be a whole number of at least {least}.")


def check_flag(what: str, value: Any) -> None:
    """Raise ValueError unless the value is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{what} is {quoted(value)}; it must be True or False.")


def check_text(what: str, value: Any) -> None:
    """Raise ValueError unless the value is a text of one line that is not empty."""
    if not isinstance(value, str) or not value.strip() or _CONTROL.search(value):
        raise ValueError(f"{what} is {quoted(value)}; it must be a text of one line.")


def check_name(what: str, value: Any, *, taken: Iterable[str] = ()) -> None:
    """Raise ValueError unless the value may name a file and a column: letters, digits, "_" and "-", a letter first."""
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        better = re.sub(r"[^A-Za-z0-9-]+", "_", value).strip("_-0123456789") if isinstance(value, str) else ""
        hint = f" {better!r} would do." if _NAME.fullmatch(better) else ""
        raise ValueError(
            f"{what} is {quoted(value)}; it must consist of letters, digits, '_' and '-' and begin with a letter.{hint}"
        )
    if value in taken:
        raise ValueError(f"{what} is {value!r}, which is taken; choose another.")


def check_task_name(what: str, value: Any) -> None:
    """Raise ValueError unless the value may be a task's name: as `check_name`, in lower case, and not "all"."""
    check_name(what, value, taken=_RESERVED)
    if value != value.lower():
        raise ValueError(f"{what} is {value!r}; a task's name is written in lower case: {value.lower()!r}.")


def check_choice(what: str, value: Any, known: Iterable[str]) -> None:
    """Raise ValueError unless the value is one of those known; a close match is named."""
    known = list(map(str, known))  # members of a StrEnum among them
    if not isinstance(value, str) or value not in known:
        raise ValueError(
            f"{what} is {quoted(value)}; known are {', '.join(map(repr, known))}.{close_match(value, known)}"
        )


def check_numbers(what: str, value: Any, n: int, *, least: float = -math.inf) -> None:
    """Raise ValueError unless the value is a row of n finite numbers of at least `least`."""
    row = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(row, (tuple, list)) or len(row) != n:
        raise ValueError(f"{what} is {quoted(value)}; it must be {n} numbers.")
    for k, number in enumerate(row):
        check_number(f"{what}[{k}]", number, least=least)


def check_kind(what: str, value: Any, kind: type | tuple[type, ...]) -> None:
    """Raise ValueError unless the value is an instance of a class, or of one of several."""
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if not isinstance(value, kinds):
        words = (_IN_WORDS.get(k.__name__, k.__name__) for k in kinds)
        names = ["None" if word == "NoneType" else f"{'an' if word[0] in 'AEIOaeio' else 'a'} {word}" for word in words]
        raise ValueError(f"{what} is {quoted(value)}; it must be {' or '.join(names)}.")


def check_tuple(what: str, value: Any, kind: type) -> tuple[Any, ...]:
    """Return the value, a tuple or list of instances of a class, as a tuple; raise ValueError otherwise."""
    if not isinstance(value, (tuple, list)):
        hint = f"; a lone one needs its comma: ({kind.__name__}(...),)" if isinstance(value, kind) else ""
        raise ValueError(f"{what} is {quoted(value)}; it must be a tuple of {kind.__name__}{hint}.")
    for k, item in enumerate(value):
        check_kind(f"{what}[{k}]", item, kind)
    return tuple(value)


def check_callable(what: str, value: Any, *, such_as: str) -> None:
    """Raise ValueError unless the value can be called, and is no class that somebody forgot to call."""
    if isinstance(value, type):
        raise ValueError(f"{what} is the class {value.__name__}; give an instance of it, {value.__name__}(...).")
    if not callable(value):
        raise ValueError(f"{what} is {quoted(value)}; it must be {such_as}.")


def check_pose(what: str, value: Any) -> None:
    """Raise ValueError unless the value is a Pose: a rotation matrix and a finite position."""
    check_kind(what, value, Pose)
    rotation = finite_array(f"{what}.rotation", value.rotation, (3, 3))
    finite_array(f"{what}.position", value.position, (3,))
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0.0:
        raise ValueError(f"{what}.rotation is {quoted(rotation.tolist())}, which is no rotation matrix.")


def finite_array(what: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return the value as an array of finite numbers of that shape; raise ValueError otherwise."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{what} is {quoted(value)}; it must be finite numbers of shape {shape}.")
    return array


def is_number(value: Any) -> bool:
    """Whether the value is a real number that a float can hold; True and False are none."""
    if isinstance(value, Integral):
        return is_whole(value)
    return isinstance(value, Real)


def is_whole(value: Any) -> bool:
    """Whether the value is a whole number that a float can hold; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool) and abs(int(value)) <= sys.float_info.max
