"""The dynamic condition xi: everything that the rollouts of a group share."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from types import MappingProxyType
from typing import Any

from dynaforge.sim.checks import check_kind, check_name, check_whole, is_number, quoted
from dynaforge.sim.hidden import checked_hidden


@dataclass(frozen=True, slots=True)
class Condition:
    """A dynamic condition xi of the paper: scene initialisation and exogenous motion of one episode.

    The same condition and the same actions give the same episode, bit for bit: everything random in the scene is drawn
    from `seed`.

    Attributes:
        task: Task name, e.g. "can".
        seed: Seed of everything that `values` leaves open.
        difficulty: Nominal difficulty in the task's own unit (for Can the launch speed, m/s).
        values: The parameters of the scene by name, SI units.
        hidden: Physics that is not observed, by the names of `sim.hidden.HIDDEN`; nominal where none is given.

    Raises:
        ValueError: A field is of the wrong type, or a hidden field is unknown or negative.
    """

    task: str
    seed: int
    difficulty: float
    values: Mapping[str, float]
    _: KW_ONLY
    hidden: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_name("Condition: task", self.task)
        check_whole("Condition: seed", self.seed, least=0)
        check_kind("Condition: values", self.values, Mapping)
        if not is_number(self.difficulty):
            raise ValueError(f"Condition: difficulty is {quoted(self.difficulty)}; it must be a number.")
        for name, value in self.values.items():  # their ranges are checked by the task's ConditionSpace
            if not isinstance(name, str) or not is_number(value):
                raise ValueError(
                    f"Condition: values[{quoted(name)}] is {quoted(value)}; it must be a number with a name."
                )
        # Plain numbers, and 0.0 for -0.0: otherwise equal conditions would have different ids.
        object.__setattr__(self, "seed", int(self.seed))
        object.__setattr__(self, "difficulty", float(self.difficulty) + 0.0)
        values = {name: float(value) + 0.0 for name, value in sorted(self.values.items())}
        object.__setattr__(self, "values", MappingProxyType(values))
        object.__setattr__(self, "hidden", MappingProxyType(checked_hidden("Condition", self.hidden)))

    def __reduce__(self) -> tuple[Any, ...]:
        return Condition.from_dict, (self.to_dict(),)

    def __hash__(self) -> int:
        return hash(self.id)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that JSON stores without loss."""
        data = {"task": self.task, "seed": self.seed, "difficulty": self.difficulty, "values": dict(self.values)}
        # Left out where empty: a condition without hidden fields keeps the id that it had before there were any.
        return data | ({"hidden": dict(self.hidden)} if self.hidden else {})

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Condition:
        """Rebuild a condition from `to_dict`.

        Raises:
            ValueError: A field is missing or unknown.
        """
        check_kind("Condition", data, Mapping)
        needed = {"task", "seed", "difficulty", "values"}
        known = needed | {"hidden"}
        if missing := needed - set(data):
            raise ValueError(f"Condition lacks {sorted(missing)}; it needs {sorted(needed)}.")
        if unknown := set(data) - known:
            raise ValueError(f"Condition has unknown fields {sorted(unknown, key=str)}; known are {sorted(known)}.")
        return Condition(**data)

    @property
    def id(self) -> str:
        """Sixteen hex digits that identify the condition; equal conditions have equal ids in every process."""
        text = json.dumps(self.to_dict(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]
