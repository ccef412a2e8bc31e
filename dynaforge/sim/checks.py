"""Checks of arguments: an error names the argument, its value, what was expected and what to do.

In all of them `name` is how the argument is named in the message, such as "Condition: seed".
"""

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
_TYPE_WORDS = {"str": "text", "Mapping": "mapping"}
_CONTROL = re.compile(r"[\x00-\x1f\x7f\x85\u2028\u2029]")  # line breaks among them
_RESERVED_TASK_NAMES = ("all",)  # it means every task on the command line
_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 80


def quoted(value: Any) -> str:
    """Return a value as it is quoted in a message: on one line, and shortened."""
    try:
        text = " ".join(_REPR.repr(value).split())
        return re.sub(r" at 0x[0-9a-f]+", "", text)  # addresses differ from process to process
    except ValueError:  # Python refuses to write an integer of more than 4300 digits
        return f"a very large {type(value).__name__}"


def close_match(name: Any, known: Iterable[str]) -> str:
    """Return a sentence that suggests what was probably meant, or "".

    Args:
        name: What was given.
        known: The names that exist.
    """
    spelled = {other.lower(): other for other in known}
    close = difflib.get_close_matches(name.lower(), spelled, n=1) if isinstance(name, str) else []
    return f" Did you mean {spelled[close[0]]!r}?" if close else ""


def check_number(
    name: str, value: Any, *, least: float = -math.inf, most: float = math.inf, above: float = -math.inf
) -> None:
    """Raise ValueError unless a value is a finite number within bounds.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        least: Smallest number allowed.
        most: Largest number allowed.
        above: Number that the value must exceed.
    """
    good = is_number(value) and abs(value) < math.inf and least <= value <= most and value > above
    if not good:
        bounds = []
        if above > -math.inf:
            bounds.append(f"above {above:g}")
        elif least > -math.inf:
            bounds.append(f"of at least {least:g}")
        if most < math.inf:
            bounds.append(f"at most {most:g}")
        raise ValueError(f"{name} is {quoted(value)}; it must be a finite number {' and '.join(bounds)}".rstrip() + ".")


def check_whole(name: str, value: Any, *, least: int) -> None:
    """Raise ValueError unless a value is a whole number of at least `least`.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        least: Smallest number allowed.
    """
    if not is_whole(value) or value < least:
        raise ValueError(f"{name} is {quoted(value)}; it must be a whole number of at least {least}.")


def check_flag(name: str, value: Any) -> None:
    """Raise ValueError unless a value is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} is {quoted(value)}; it must be True or False.")


def check_text(name: str, value: Any) -> None:
    """Raise ValueError unless a value is a text of one line that is not empty."""
    if not isinstance(value, str) or not value.strip() or _CONTROL.search(value):
        raise ValueError(f"{name} is {quoted(value)}; it must be a text of one line.")


def check_name(name: str, value: Any, *, taken: Iterable[str] = ()) -> None:
    """Raise ValueError unless a value can name a file and a column: letters, digits, "_" and "-", a letter first.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        taken: Names that are in use already.
    """
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        better = re.sub(r"[^A-Za-z0-9-]+", "_", value).strip("_-0123456789") if isinstance(value, str) else ""
        hint = f" {better!r} would do." if _NAME.fullmatch(better) else ""
        raise ValueError(
            f"{name} is {quoted(value)}; it must consist of letters, digits, '_' and '-' and begin with a letter.{hint}"
        )
    if value in taken:
        raise ValueError(f"{name} is {value!r}, which is taken; choose another.")


def check_task_name(name: str, value: Any) -> None:
    """Raise ValueError unless a value can be the name of a task: as in `check_name`, in lower case, and not "all"."""
    check_name(name, value, taken=_RESERVED_TASK_NAMES)
    if value != value.lower():
        raise ValueError(f"{name} is {value!r}; a task's name is written in lower case: {value.lower()!r}.")


def check_choice(name: str, value: Any, known: Iterable[str | None]) -> None:
    """Raise ValueError unless a value is one of those known, which may include None; a close match is suggested.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        known: The values allowed.
    """
    texts = [None if each is None else str(each) for each in known]  # members of a StrEnum become plain texts
    if not isinstance(value, (str, type(None))) or value not in texts:
        close = close_match(value, [text for text in texts if text is not None])
        raise ValueError(f"{name} is {quoted(value)}; it must be one of {', '.join(map(repr, texts))}.{close}")


def check_numbers(name: str, value: Any, n: int, *, least: float = -math.inf) -> None:
    """Raise ValueError unless a value is a tuple, list or array of n finite numbers.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        n: How many numbers.
        least: Smallest number allowed.
    """
    row = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(row, (tuple, list)) or len(row) != n:
        raise ValueError(f"{name} is {quoted(value)}; it must be {n} numbers.")
    for k, number in enumerate(row):
        check_number(f"{name}[{k}]", number, least=least)


def check_kind(name: str, value: Any, kind: type | tuple[type, ...]) -> None:
    """Raise ValueError unless a value is an instance of a class.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        kind: The class, or several of which one will do.
    """
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if not isinstance(value, kinds):
        words = (_TYPE_WORDS.get(k.__name__, k.__name__) for k in kinds)
        names = ["None" if word == "NoneType" else f"{'an' if word[0] in 'AEIOaeio' else 'a'} {word}" for word in words]
        raise ValueError(f"{name} is {quoted(value)}; it must be {' or '.join(names)}.")


def check_tuple(name: str, value: Any, kind: type) -> tuple[Any, ...]:
    """Return a tuple or list of instances of a class as a tuple; raise ValueError for anything else.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        kind: The class.
    """
    if not isinstance(value, (tuple, list)):
        hint = f"; a lone one needs its comma: ({kind.__name__}(...),)" if isinstance(value, kind) else ""
        raise ValueError(f"{name} is {quoted(value)}; it must be a tuple of {kind.__name__}{hint}.")
    for k, item in enumerate(value):
        check_kind(f"{name}[{k}]", item, kind)
    return tuple(value)


def check_callable(name: str, value: Any, *, expected: str) -> None:
    """Raise ValueError unless a value can be called; a class, which somebody forgot to call, is refused too.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        expected: What it must be, for the message.
    """
    if isinstance(value, type):
        raise ValueError(f"{name} is the class {value.__name__}; give an instance of it, {value.__name__}(...).")
    if not callable(value):
        raise ValueError(f"{name} is {quoted(value)}; it must be {expected}.")


def check_pose(name: str, value: Any) -> None:
    """Raise ValueError unless a value is a Pose with a rotation matrix and a finite position."""
    check_kind(name, value, Pose)
    rotation = finite_array(f"{name}.rotation", value.rotation, (3, 3))
    finite_array(f"{name}.position", value.position, (3,))
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0.0:
        raise ValueError(f"{name}.rotation is {quoted(rotation.tolist())}, which is not a rotation matrix.")


def finite_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return a value as an array of finite numbers; raise ValueError for anything else.

    Args:
        name: Name of the argument in messages.
        value: Its value.
        shape: The shape that it must have.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name} is {quoted(value)}; it must be finite numbers of shape {shape}.")
    return array


def is_number(value: Any) -> bool:
    """Return whether a value is a real number that fits a float; True and False are not."""
    if isinstance(value, Integral):
        return is_whole(value)
    return isinstance(value, Real)


def is_whole(value: Any) -> bool:
    """Return whether a value is a whole number that fits a float; True and False are not."""
    return isinstance(value, Integral) and not isinstance(value, bool) and abs(int(value)) <= sys.float_info.max
