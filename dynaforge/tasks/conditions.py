"""Where conditions come from: a task's ranges, and named streams of draws from them."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from dynaforge.sim import Condition

STREAMS = ("train", "val", "test")


@dataclass(frozen=True, slots=True)
class ConditionSpace:
    """The configured range of a task's conditions; every value is uniform in its range.

    Attributes:
        task: Task name.
        difficulty: The field that is the nominal difficulty; strata divide its range evenly.
        ranges: Field name to (low, high), SI units.
        units: Field name to its unit, for people who read it; no entry for a plain number such as a side.

    Raises:
        ValueError: A unit is given for a field that has no range.
    """

    task: str
    difficulty: str
    ranges: Mapping[str, tuple[float, float]]
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.units) - set(self.ranges)):
            raise ValueError(f"Units are given for {unknown}, which are no fields; there are {sorted(self.ranges)}.")
        object.__setattr__(self, "ranges", MappingProxyType(dict(self.ranges)))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    def __reduce__(self) -> tuple[Any, ...]:
        return ConditionSpace, (self.task, self.difficulty, dict(self.ranges), dict(self.units))

    @property
    def difficulty_range(self) -> tuple[float, float]:
        """Lowest and highest nominal difficulty."""
        return self.ranges[self.difficulty]

    def stratum(self, difficulty: float, n_strata: int) -> int:
        """Which of `n_strata` equal parts of its range a difficulty falls into; the ends belong to the outer ones."""
        low, high = self.difficulty_range
        return min(max(int((difficulty - low) / (high - low) * n_strata), 0), n_strata - 1)

    def draw(self, rng: np.random.Generator, stratum: int | None = None, n_strata: int = 1) -> Condition:
        """Draw one condition.

        Args:
            rng: Source of the draw.
            stratum: Draw the difficulty from this one of `n_strata` equal parts of its range; None: from all of it.
            n_strata: Number of strata N.

        Raises:
            ValueError: No such stratum.
        """
        if stratum is not None and not 0 <= stratum < n_strata:
            raise ValueError(f"Stratum {stratum} does not exist among {n_strata}; use 0 to {n_strata - 1}.")
        unit = {name: float(rng.random()) for name in self.ranges}
        if stratum is not None:
            unit[self.difficulty] = (stratum + unit[self.difficulty]) / n_strata
        values = {name: low + unit[name] * (high - low) for name, (low, high) in self.ranges.items()}
        return Condition(self.task, int(rng.integers(2**31)), values[self.difficulty], values)

    def reset_kwargs(self, condition: Condition) -> dict[str, Any]:
        """Return what `env.reset` takes to run this condition."""
        return {"options": {"condition": condition}}

    def validate(self, condition: Condition) -> Condition:
        """Return the condition if it belongs here.

        Raises:
            ValueError: Another task's condition, a missing or unknown field, or a value out of range.
        """
        if condition.task != self.task:
            raise ValueError(f"Condition belongs to task {condition.task!r}, this is {self.task!r}.")
        if missing := sorted(set(self.ranges) - set(condition.values)):
            raise ValueError(f"Condition of task {self.task!r} lacks {missing}; it needs {sorted(self.ranges)}.")
        if unknown := sorted(set(condition.values) - set(self.ranges)):
            raise ValueError(f"Condition of task {self.task!r} has unknown fields {unknown}.")
        for name, (low, high) in self.ranges.items():
            if not low - 1e-9 <= condition.values[name] <= high + 1e-9:
                raise ValueError(f"Condition field {name!r} is {condition.values[name]}, outside [{low}, {high}].")
        if condition.difficulty != condition.values[self.difficulty]:
            raise ValueError(
                f"Condition's difficulty {condition.difficulty} is not its {self.difficulty} "
                f"{condition.values[self.difficulty]}."
            )
        return condition

    def stream(self, stream: str, block: int = 0, *, n_strata: int | None = None) -> Iterator[Condition]:
        """Iterate without end over the conditions of (task, stream, block, 0), (task, stream, block, 1) and so on.

        With `n_strata`, index i falls into stratum i modulo `n_strata`.

        Raises:
            ValueError: Unknown stream.
        """
        if stream not in STREAMS:
            raise ValueError(f"No condition stream {stream!r}; known are {', '.join(STREAMS)}.")
        index = 0
        while True:
            key = (zlib.crc32(self.task.encode()), STREAMS.index(stream), block, index)
            rng = np.random.default_rng(np.random.SeedSequence(key))
            yield self.draw(rng, None if n_strata is None else index % n_strata, n_strata or 1)
            index += 1
