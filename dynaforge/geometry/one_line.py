"""The `repr` of dataclasses that contain arrays: one line, with long arrays as type and shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

LONGEST = 9  # items of an array or list that are written out, enough for a rotation matrix


def one_line(value: Any) -> str:
    """Return a dataclass as text on one line; classes that contain arrays use it as their `__repr__`."""
    parts = ", ".join(f"{field.name}={_brief(getattr(value, field.name))}" for field in fields(value))
    return f"{type(value).__name__}({parts})"


def _brief(value: Any) -> str:
    """Return the value of a field as short text."""
    if isinstance(value, np.ndarray) and value.size <= LONGEST and value.dtype.kind in "biuf":
        return str(value.round(4).tolist())
    if getattr(value, "ndim", 0):  # an array of numpy or a tensor of torch
        return f"{value.dtype}{list(value.shape)}"
    if isinstance(value, Mapping):
        return f"{{{', '.join(map(str, value))}}}" if len(value) <= LONGEST else f"{len(value)} entries"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_brief, value))}]" if len(value) <= LONGEST else f"{len(value)} entries"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    return " ".join(repr(value).split())
