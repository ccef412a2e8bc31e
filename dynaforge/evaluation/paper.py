"""The paper's figures of demonstration generation, to be shown beside measured ones."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

_TASKS = ("can", "bottle", "toycar", "lemon", "alarmclock", "peach", "block", "pen", "peg")
_ROWS: dict[str, tuple[tuple[float, float] | None, ...]] = {
    "state_machine": (
        (42.67, 5.44),
        (28.00, 2.16),
        (51.67, 2.49),
        None,
        None,
        (19.33, 4.99),
        (3.67, 2.49),
        None,
        None,
    ),
    "dmp": (
        (20.67, 1.25),
        (12.67, 4.19),
        (16.67, 1.70),
        (14.33, 2.05),
        (7.33, 3.86),
        (9.00, 3.27),
        (12.33, 2.05),
        (27.67, 1.70),
        (0.00, 0.00),
    ),
    "planner_only": (
        (46.67, 2.05),
        (21.33, 1.25),
        (67.67, 2.62),
        (72.00, 2.45),
        (51.33, 1.70),
        (18.67, 4.50),
        (54.00, 3.74),
        (32.33, 2.49),
        (7.67, 0.94),
    ),
    "residual": (
        (74.67, 2.05),
        (79.00, 2.16),
        (98.67, 1.25),
        (84.00, 2.16),
        (100.00, 0.00),
        (75.00, 2.94),
        (96.67, 1.70),
        (69.33, 1.25),
        (28.00, 3.74),
    ),
}

PAPER_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "state_machine": "DynamicVLA",
        "dmp": "DMG",
        "planner_only": "DynaForge (w/o residual policy)",
        "residual": "DynaForge (w/ residual policy)",
    }
)
"""What the paper calls the generators that it measures, by our names of them."""

PAPER_DGR: Mapping[str, Mapping[str, tuple[float, float] | None]] = MappingProxyType(
    {name: MappingProxyType(dict(zip(_TASKS, row, strict=True))) for name, row in _ROWS.items()}
)
"""The paper's first table: by generator and task, DGR and its standard deviation over three seeds of 100 attempts, in
per cent; None where the generator does not support the task."""
