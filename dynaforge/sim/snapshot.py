"""What an object remembered at some moment, to be put back later."""

from __future__ import annotations

from collections import deque
from typing import Any

Memory = list[tuple[Any, dict[str, Any]]]


def remember(*parts: Any) -> Memory:
    """Note the attributes of objects.

    Lists, dicts and deques among the attributes are copied. Every other value is kept as it is: an object that changes
    must be given as a part of its own, and arrays must be replaced, not written to.

    Args:
        parts: The objects.
    """
    return [(part, _copied(vars(part))) for part in parts]


def put_back(memory: Memory) -> None:
    """Give the objects the attributes that they had; it may be done any number of times."""
    for part, attributes in memory:
        for name, value in _copied(attributes).items():
            setattr(part, name, value)


def _copied(attributes: dict[str, Any]) -> dict[str, Any]:
    return {
        name: value.copy() if isinstance(value, (list, dict, deque)) else value for name, value in attributes.items()
    }
