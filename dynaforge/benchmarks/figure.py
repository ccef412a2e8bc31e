"""A figure of `dynaforge bench`: a target, what was measured, and whether the target is met."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any, TypeVar

from tqdm import tqdm

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One line of the table.

    Attributes:
        title: What was measured.
        target: What it should be.
        measured: What it is, in words and SI units.
        ok: Whether the target is met.
        raw: The measurements behind it, plain data for JSON.
    """

    title: str
    target: str
    measured: str
    ok: bool
    raw: dict[str, Any] = field(default_factory=dict)


def spread(values: Sequence[float], *, digits: int = 2) -> str:
    """Return median and range as text, such as "0.72 (0.70 to 0.75)"."""
    return f"{median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def tracked(items: Iterable[Item], title: str, *, total: int | None = None) -> Iterable[Item]:
    """Iterate over items with a progress bar on a terminal.

    Args:
        items: The items.
        title: Text in front of the bar.
        total: Number of items, if they do not know it.
    """
    bar: Iterable[Item] = tqdm(items, desc=title, total=total, leave=False, disable=None)
    return bar
