"""The robot's collision reflex: it stops when something pushes back too hard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, get_args

import numpy as np

from dynaforge.geometry import Array, one_line
from dynaforge.sim.checks import check_choice, check_number, is_number

ReflexName = Literal["contact", "standard", "strict", "off"]
REFLEX_NAMES: tuple[ReflexName, ...] = get_args(ReflexName)


@dataclass(frozen=True, slots=True, eq=False)
class Thresholds:
    """What external loads the robot bears before its collision reflex stops it.

    Attributes:
        force: On the hand, newtons.
        moment: On the hand, about the end-effector frame's origin, Nm.
        torque: On each joint, Nm, shape (7,).
    """

    force: float
    moment: float
    torque: Array

    __repr__ = one_line


THRESHOLDS: Mapping[ReflexName, Thresholds] = MappingProxyType(
    {
        "contact": Thresholds(100.0, 100.0, np.full(7, 100.0)),
        "standard": Thresholds(40.0, 35.0, np.array((35.0, 35.0, 32.0, 30.0, 29.0, 27.0, 24.0))),
        "strict": Thresholds(20.0, 25.0, np.array((20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0))),
        "off": Thresholds(np.inf, np.inf, np.full(7, np.inf)),
    }
)
"""Settings of `setCollisionBehavior` in use on Franka's robots. "contact": what libfranka's maintainers advise for
contact work. "standard": Franka's ROS 2 controllers. "strict": what franka_ros shipped. "off": no reflex."""


NAMED = tuple(name for name in REFLEX_NAMES if name != "off")
"""The thresholds that can be exceeded, softest first."""


def thresholds(reflex: ReflexName | float) -> Thresholds:
    """Return the thresholds of a name, or those of "contact" with another force.

    Args:
        reflex: A name, or the force on the hand that stops the robot, newtons.

    Raises:
        ValueError: No such name, or a number that is not above 0.
    """
    if isinstance(reflex, str) or not is_number(reflex):
        check_choice("reflex, unless it is a number of newtons,", reflex, REFLEX_NAMES)
        return THRESHOLDS[reflex]  # type: ignore[index]
    check_number("reflex", reflex, above=0.0)
    contact = THRESHOLDS["contact"]
    return Thresholds(float(reflex), contact.moment, contact.torque)


def named_within(reflex: ReflexName | float) -> tuple[ReflexName, ...]:
    """Return the named thresholds, softest first, of which attempts under a reflex tell whether they were exceeded.

    They are those that are no higher than its own: what comes after the robot has stopped is not known.

    Args:
        reflex: What the attempts were made under.

    Raises:
        ValueError: As `thresholds`.
    """
    own = thresholds(reflex)
    return tuple(
        name
        for name in NAMED
        if (named := THRESHOLDS[name]).force <= own.force
        and named.moment <= own.moment
        and (named.torque <= own.torque).all()
    )
