"""How a recording differs from the same attempt made again, column by column, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.episode import Episode

RUN_SPECIFIC = ("versions", "policy_hash")  # entries of `meta` that a repetition cannot know


def differences(recorded: Episode, again: Episode) -> list[str]:
    """Compare everything that a repetition determines: outcome, `meta`, and every column.

    Columns that differ at the earliest step are reported on their own: later differences may only follow from them.

    Args:
        recorded: The recording.
        again: The same attempt, made again.

    Returns:
        One sentence for each difference; empty where there is none.
    """
    noted, repeated = _outcome(recorded), _outcome(again)
    found = [
        f"its {name} is recorded as {noted[name]!r}, made again it is {value!r}"
        for name, value in repeated.items()
        if noted[name] != value
    ]
    found += [
        f"its {name} is not what its attempt made again gives"
        for name, value in again.meta.items()
        if name not in RUN_SPECIFIC and recorded.meta.get(name) != value
    ]
    return found + _columns(recorded, again)


def _outcome(episode: Episode) -> dict[str, Any]:
    return episode.outcome.to_dict() | {"duration": episode.duration, "greatest load": episode.loads}


def _columns(recorded: Episode, again: Episode) -> list[str]:
    known = [name for name in recorded.steps if not name.startswith("extra/")]
    found = [f"{name} is missing, which every attempt records" for name in again.steps if name not in recorded.steps]
    found += [f"{name} is recorded, which no attempt at this task does" for name in known if name not in again.steps]
    if len(recorded) != len(again):
        found.append(f"it has {len(recorded)} control steps, made again {len(again)}")
    first = {
        name: step
        for name in known
        if name in again.steps and (step := first_row(recorded.steps[name], again.steps[name])) is not None
    }
    start = min(first.values(), default=0)
    found += [
        f"{name} is not what its attempt made again gives from step {step} on"
        f"{_by(recorded.steps[name][step], again.steps[name][step])}"
        for name, step in first.items()
        if step == start
    ]
    if later := [f"{name} (step {step})" for name, step in first.items() if step > start]:
        found.append(f"later, which may follow from it, {', '.join(later)} too")
    return found


def first_row(a: NDArray[Any], b: NDArray[Any]) -> int | None:
    """Return the first row in which two columns differ, up to the end of the shorter one; None if there is none."""
    if a.shape[1:] != b.shape[1:]:
        return 0
    rows = min(len(a), len(b))
    wrong = np.flatnonzero((a[:rows] != b[:rows]).reshape(rows, -1).any(axis=1))
    return int(wrong[0]) if len(wrong) else None


def _by(a: Any, b: Any) -> str:
    if np.shape(a) != np.shape(b):
        return ": it has another shape"
    return f", by {np.abs(np.asarray(a, dtype=float) - np.asarray(b, dtype=float)).max():.3g}"
