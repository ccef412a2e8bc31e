"""Picking from a rack: the phases by which the prior takes an object that stands at rest."""

from __future__ import annotations

from dynaforge.tasks.predicates import All, Grasped, Lifted, Reached
from dynaforge.tasks.targets import Above, Grip, Raised
from dynaforge.tasks.task import Mode, Phase


def from_rack(held: str, *, grip: float, precision: float, lift: float, clear: float) -> tuple[Phase, ...]:
    """Reach over an upright object, go down, close, lift; the object in the hand is measured at the end.

    Args:
        held: The object.
        grip: Of the hand above the object's middle, metres.
        precision: How near the hand must come before it closes, metres.
        lift: How far the hand goes up, metres.
        clear: How far the object must have gone up, metres.
    """
    return (
        Phase(
            "reach", Mode.GLOBAL, Above(held, grip + 0.05, Grip.KEPT), width=0.04,
            done=Reached(0.015), timeout=2.0, failure="not reached",
        ),
        Phase(
            "descend", Mode.IK, Above(held, grip, Grip.KEPT), width=0.04,
            done=Reached(precision), timeout=1.0, failure="not reached",
        ),
        Phase(
            "close", Mode.IK, Above(held, grip, Grip.KEPT), width=0.0,
            done=Grasped(held), hold=0.1, timeout=0.8, failure="missed close",
        ),
        Phase(
            "lift", Mode.GLOBAL, Raised(held, lift), width=0.0, takes_hold=True,
            done=All((Lifted(held, clear), Grasped(held))), timeout=1.5, failure="slipped",
        ),
    )  # fmt: skip
