"""Hidden physics: what differs between real objects and laboratories, varies by condition, and is never observed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from dynaforge.sim.checks import check_choice, check_kind, check_number

Level = Literal["fixed", "varied", "wide"]
Widened = Literal[
    "wide:object_friction",
    "wide:finger_friction",
    "wide:table_friction",
    "wide:rolling_friction",
    "wide:mass",
    "wide:joint_gain",
    "wide:hand_delay",
]
"""Physics in which one field alone is wide, and the others are as in "varied"."""
Physics = Level | Widened | Literal["fine"]
"""How far hidden physics varies; "fine" varies as "varied" does, in substeps of half the length."""
LEVELS: tuple[Level, ...] = get_args(Level)
PHYSICS: tuple[Physics, ...] = (*LEVELS, *get_args(Widened), "fine")
Range = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class HiddenField:
    """One quantity of the physics that the policy is not told.

    Attributes:
        meaning: What it is, and its unit; a factor multiplies the value that the scene gives.
        nominal: Its value where a condition does not give one.
        varied: The range of conditions with varied physics.
        wide: That of conditions that test what was trained on varied physics.
        reason: Why we chose these ranges.
    """

    meaning: str
    nominal: float
    varied: Range
    wide: Range
    reason: str


HIDDEN: Mapping[str, HiddenField] = {
    "object_friction": HiddenField(
        meaning="factor on the Coulomb coefficients of the object",
        nominal=1.0,
        varied=(0.8, 1.2),
        wide=(0.6, 1.5),
        reason="A fifth seems right between clean and handled surfaces. Bullet multiplies the coefficients of both "
        "bodies, so that those of a contact vary by 0.64 to 1.44.",
    ),
    "finger_friction": HiddenField(
        meaning="factor on the Coulomb coefficient of the finger pads",
        nominal=1.0,
        varied=(0.8, 1.2),
        wide=(0.6, 1.5),
        reason="Rubber pads wear and gather dust; printed or taped fingers differ more.",
    ),
    "table_friction": HiddenField(
        meaning="factor on the Coulomb coefficients of the table and of fixtures",
        nominal=1.0,
        varied=(0.8, 1.2),
        wide=(0.6, 1.5),
        reason="Wood, laminate and metal should lie within a fifth of the scene's table; cloth and glass do not.",
    ),
    "rolling_friction": HiddenField(
        meaning="factor on the friction lengths against rolling",
        nominal=1.0,
        varied=(1.0, 2.0),
        wide=(1.0, 4.0),
        reason="Dents, labels and soft tables may double it; the nominal lengths are small, so they only grow.",
    ),
    "mass": HiddenField(
        meaning="factor on the mass of every free body, where the task's own conditions give none",
        nominal=1.0,
        varied=(0.8, 1.2),
        wide=(0.5, 2.0),
        reason="Objects of one kind may differ by a fifth; full ones weigh twice as much as half full ones.",
    ),
    "joint_gain": HiddenField(
        meaning="factor on the position gain of the arm's motors",
        nominal=1.0,
        varied=(0.85, 1.15),
        wide=(0.7, 1.3),
        reason="How stiffly a joint follows its reference differs with controller, payload and friction in the gears.",
    ),
    "hand_delay": HiddenField(
        meaning="dead time of the hand, seconds",
        nominal=0.1,
        varied=(0.05, 0.15),
        wide=(0.0, 0.25),
        reason="Users of the Franka Hand report 0.1 s and more from a command to its motion, at no fixed time.",
    ),
}
"""Every hidden field by name. The ranges are engineering judgement, not measurements: the same for all tasks, and
chosen before any training."""


def hidden_ranges(physics: Physics, *, mass: bool) -> dict[str, Range]:
    """Return the range of every hidden field that varies.

    Args:
        physics: How far physics varies.
        mass: Whether the mass varies.

    Raises:
        ValueError: The mass alone is to be wide, and does not vary.
    """
    if physics == "fixed":
        return {}
    if physics == "wide:mass" and not mass:
        raise ValueError("physics is 'wide:mass', but in this task the mass is a field of its own, or no body is free.")
    return {
        name: field.wide if physics in ("wide", f"wide:{name}") else field.varied
        for name, field in HIDDEN.items()
        if name != "mass" or mass
    }


def checked_hidden(place: str, values: object) -> dict[str, float]:
    """Return hidden fields as plain numbers by name, in the order of the names.

    Args:
        place: What they belong to, for the message.
        values: Mapping of names to numbers.

    Raises:
        ValueError: It is not, a name is unknown, or a value is negative or not finite.
    """
    check_kind(f"{place}: hidden", values, Mapping)
    assert isinstance(values, Mapping)
    for name, value in values.items():
        check_choice(f"{place}: a hidden field", name, HIDDEN)
        check_number(f"{place}: hidden[{name!r}]", value, least=0.0)
    return {name: float(value) + 0.0 for name, value in sorted(values.items())}
