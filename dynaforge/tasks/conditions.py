"""Where conditions come from: a task's ranges, and named streams of conditions drawn from them."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from dynaforge.sim import Condition
from dynaforge.sim.checks import (
    check_choice,
    check_kind,
    check_name,
    check_number,
    check_numbers,
    check_task_name,
    check_text,
    check_whole,
    is_whole,
    quoted,
)
from dynaforge.sim.hidden import HIDDEN

Stream = Literal["train", "val", "test"]
STREAMS: tuple[Stream, ...] = get_args(Stream)


@dataclass(frozen=True, slots=True)
class ConditionSpace:
    """The ranges of a task's conditions; each value is drawn uniformly from its range.

    Attributes:
        task: Task name.
        difficulty: Name of the field that is the nominal difficulty; strata divide its range into equal parts.
        ranges: Field name to (low, high), SI units.
        units: Field name to its unit, to be read by people; no entry for a plain number such as a side.
        hidden: Ranges of the hidden fields that vary (`sim.hidden`); a task sets them by its setting.

    Raises:
        ValueError: A range is empty or reversed, `difficulty` or a key of `units` is not a field, or a key of `hidden`
            is not a hidden field.
    """

    task: str
    difficulty: str
    ranges: Mapping[str, tuple[float, float]]
    units: Mapping[str, str] = field(default_factory=dict)
    hidden: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_task_name("ConditionSpace: task", self.task)
        for name in ("ranges", "units", "hidden"):
            check_kind(f"ConditionSpace: {name}", getattr(self, name), Mapping)
        for name in self.ranges:
            check_name("ConditionSpace: a field of ranges", name)
        for name in self.hidden:
            check_choice("ConditionSpace: a field of hidden", name, HIDDEN)
        for name, ends in (*self.ranges.items(), *self.hidden.items()):
            check_numbers(f"ConditionSpace: the range of {name!r}", ends, 2)
            if not ends[0] < ends[1]:
                problem = "empty; a value that never varies belongs in launch" if ends[0] == ends[1] else "reversed"
                raise ValueError(f"ConditionSpace: the range {quoted(ends)} of {name!r}, (low, high), is {problem}.")
        if not self.ranges:
            raise ValueError("ConditionSpace: ranges is empty; at least the difficulty has one.")
        check_choice("ConditionSpace: difficulty", self.difficulty, self.ranges)
        if unknown := sorted(set(self.units) - set(self.ranges), key=str):
            raise ValueError(
                f"Units are given for {unknown}, which are not fields; the fields are {sorted(self.ranges)}."
            )
        for name, unit in self.units.items():
            check_text(f"ConditionSpace: the unit of {name!r} in units", unit)
        for name in ("ranges", "units", "hidden"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __reduce__(self) -> tuple[Any, ...]:
        return ConditionSpace, (self.task, self.difficulty, dict(self.ranges), dict(self.units), dict(self.hidden))

    @property
    def difficulty_range(self) -> tuple[float, float]:
        """Lowest and highest nominal difficulty."""
        return self.ranges[self.difficulty]

    @property
    def speed(self) -> str | None:
        """Name of the field that is the speed of what moves, by its unit m/s; None where no field is, or two may be.

        The difficulty goes before the others, since it is the speed of what is hard to follow.
        """
        speeds = [name for name in self.ranges if self.units.get(name) == "m/s"]
        return self.difficulty if self.difficulty in speeds else speeds[0] if len(speeds) == 1 else None

    def stratum(self, difficulty: float, n_strata: int) -> int:
        """Return which of `n_strata` equal parts of the range a difficulty falls into; outliers count to the ends."""
        check_whole("n_strata", n_strata, least=1)
        check_number("difficulty", difficulty)
        low, high = self.difficulty_range
        return int(min(max((difficulty - low) / (high - low) * n_strata, 0.0), n_strata - 1))

    def draw(self, rng: np.random.Generator, stratum: int | None = None, n_strata: int = 1) -> Condition:
        """Draw one condition.

        Hidden fields are drawn last, so that one source gives the same visible fields however far physics varies.

        Args:
            rng: Source of randomness.
            stratum: The part of its range from which the difficulty is drawn; None: from the whole range.
            n_strata: Number of equal parts N.

        Raises:
            ValueError: There is no such stratum.
        """
        check_kind("rng", rng, np.random.Generator)
        check_whole("n_strata", n_strata, least=1)
        if stratum is not None and not (is_whole(stratum) and 0 <= stratum < n_strata):
            raise ValueError(f"Stratum {quoted(stratum)} does not exist among {n_strata}; use 0 to {n_strata - 1}.")
        shares = {name: float(rng.random()) for name in self.ranges}
        if stratum is not None:
            shares[self.difficulty] = (stratum + shares[self.difficulty]) / n_strata
        values = {name: low + shares[name] * (high - low) for name, (low, high) in self.ranges.items()}
        seed = int(rng.integers(2**31))
        hidden = {name: low + float(rng.random()) * (high - low) for name, (low, high) in self.hidden.items()}
        return Condition(self.task, seed, values[self.difficulty], values, hidden=hidden)

    def reset_kwargs(self, condition: Condition) -> dict[str, Any]:
        """Return the keyword arguments of `env.reset` that run this condition."""
        return {"options": {"condition": condition}}

    def validate(self, condition: Condition) -> Condition:
        """Return the condition if it belongs to this space; a hidden field may be missing, or nominal, in any of them.

        Raises:
            ValueError: It is another task's, lacks a field, has an unknown one, or a value is out of range.
        """
        check_kind("condition", condition, Condition)
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
        self._check_hidden(condition)
        return condition

    def _check_hidden(self, condition: Condition) -> None:
        for name, value in condition.hidden.items():
            nominal = HIDDEN[name].nominal
            low, high = self.hidden.get(name, (nominal, nominal))
            if name in self.ranges:
                raise ValueError(f"Condition's hidden field {name!r} is a field of task {self.task!r}; give it there.")
            if not low - 1e-9 <= value <= high + 1e-9 and value != nominal:
                raise ValueError(
                    f"Condition's hidden field {name!r} is {value:g}, outside [{low:g}, {high:g}], its range in this "
                    "setting; a setting with other physics (fixed, varied, wide) may allow it."
                )

    def stream(
        self, stream: Stream, block: int = 0, *, n_strata: int | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Iterator[Condition]:
        """Iterate endlessly over the conditions of a block: the k-th is drawn from the seed (task, stream, block, k).

        Args:
            stream: "train", "val" or "test".
            block: Number of the block.
            n_strata: If given, the k-th condition is drawn from stratum k modulo `n_strata`.
            shard: (i, n): the i-th of every n conditions; the others are not drawn.

        Raises:
            ValueError: The stream is unknown, or `block`, `n_strata` or `shard` is out of range.
        """
        if not isinstance(stream, str) or stream not in STREAMS:
            raise ValueError(f"No condition stream {quoted(stream)}; known are {', '.join(STREAMS)}.")
        check_whole("block", block, least=0)
        if n_strata is not None:
            check_whole("n_strata", n_strata, least=1)
        check_shard(shard)
        return self._conditions(STREAMS.index(stream), block, n_strata, shard)

    def _conditions(self, stream: int, block: int, n_strata: int | None, shard: tuple[int, int]) -> Iterator[Condition]:
        for index in itertools.count(*shard):
            key = (zlib.crc32(self.task.encode()), stream, block, index)
            rng = np.random.default_rng(np.random.SeedSequence(key))
            yield self.draw(rng, None if n_strata is None else index % n_strata, n_strata or 1)


def check_shard(shard: tuple[int, int]) -> None:
    """Raise ValueError unless a shard is (i, n) with 0 <= i < n."""
    if not isinstance(shard, (tuple, list)) or len(shard) != 2:
        raise ValueError(f"shard is {quoted(shard)}; it must be (i, n): the i-th of every n conditions.")
    check_whole("shard: n", shard[1], least=1)
    check_whole("shard: i", shard[0], least=0)
    if shard[0] >= shard[1]:
        raise ValueError(f"shard is {quoted(shard)}; the last of {shard[1]} shards is {shard[1] - 1}.")
