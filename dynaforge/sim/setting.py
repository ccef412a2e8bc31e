"""The setting of a task: when the robot stops, what varies between conditions, and what may be sensed."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, cast, get_args

from dynaforge.sim.checks import check_choice, check_kind
from dynaforge.sim.delays import Sensing
from dynaforge.sim.hidden import PHYSICS, Physics
from dynaforge.sim.reflex import ReflexName, thresholds

__all__ = ["PHYSICS", "SENSINGS", "Physics", "Reflex", "Sensing", "Setting"]

Reflex = ReflexName | float
SENSINGS: tuple[Sensing, ...] = get_args(Sensing)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What holds for a task besides its definition: the same task may be run under several settings.

    A setting is part of the digest of a task, so that recordings and policies of different settings are told apart.

    Attributes:
        reflex: External force at which the robot stops: a named threshold (`sim.reflex`), or newtons.
        physics: How far hidden physics varies between conditions (`sim.hidden`): "fixed", "varied", "wide", or
            "wide:FIELD", where all fields but one are as in "varied", or "fine", as "varied" in substeps of half the
            length.
        sensing: What planner and policy see: "ideal", the truth, or "real", which is late and noisy.

    Raises:
        ValueError: A field is of the wrong type, unknown or out of range.
    """

    reflex: Reflex = "contact"
    physics: Physics = "varied"
    sensing: Sensing = "ideal"

    def __post_init__(self) -> None:
        thresholds(self.reflex)
        if not isinstance(self.reflex, str):
            object.__setattr__(self, "reflex", float(self.reflex))
        check_choice("physics", self.physics, PHYSICS)
        check_choice("sensing", self.sensing, SENSINGS)

    def __str__(self) -> str:
        unit = "" if isinstance(self.reflex, str) else " N"
        words = self.words()
        return f"reflex {words['reflex']}{unit}, physics {words['physics']}, sensing {words['sensing']}"

    def words(self) -> dict[str, str]:
        """Return every field as it is written on the command line, by name."""
        reflex = self.reflex if isinstance(self.reflex, str) else f"{self.reflex:g}"
        return {"reflex": reflex, "physics": self.physics, "sensing": self.sensing}

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that JSON stores without loss."""
        return asdict(self)

    @staticmethod
    def from_dict(data: Any) -> Setting:
        """Rebuild a setting from `to_dict`.

        Raises:
            ValueError: It is not a mapping, or a field is missing, unknown or out of range.
        """
        check_kind("setting", data, dict)
        known = set(Setting.__slots__)
        if set(data) != known:
            raise ValueError(f"setting has the fields {sorted(data, key=str)}; it must have {sorted(known)}.")
        return Setting(**cast(dict[str, Any], data))
