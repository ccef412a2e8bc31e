"""Insertion: the phases by which the prior takes an object from a rack and puts it into something that moves."""

from __future__ import annotations

from dynaforge.tasks.predicates import All, Grasped, Lifted, Predicate, Reached, Released, Within
from dynaforge.tasks.targets import Above, Grip, Over, Raised
from dynaforge.tasks.task import Mode, Phase

Point = tuple[float, float, float]


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


def into(
    held: str,
    hole: str,
    tip: Point,
    *,
    heights: tuple[float, float, float],
    precision: float,
    entered: Predicate,
    inside: Predicate,
    fails: tuple[tuple[str, Predicate], ...],
) -> tuple[Phase, ...]:
    """Carry an object over a hole that moves, go with it, put the tip in, go down, let go.

    The fingers centre themselves slowly, so the object in the hand is measured anew before every step closer.

    Args:
        held: The object.
        hole: What it goes into; its frame is the middle of its floor.
        tip: Of the object, in its frame, metres.
        heights: Of the tip above the floor while it waits, once it has entered, and at the end, metres.
        precision: How near the tip must come to its place above the hole before it goes down, metres.
        entered: The tip is in the mouth.
        inside: The object is where it belongs.
        fails: How it may be lost from the hand on the way.
    """  # fmt: skip
    hover, low, lowest = (Over(hole, held, height, tool=tip, upright=True) for height in heights)
    return (
        Phase(
            "carry", Mode.GLOBAL, hover, width=0.0, takes_hold=True,
            done=Reached(0.02), timeout=2.0, failure="not carried", fails=fails,
        ),
        Phase(
            "align", Mode.IK, hover, width=0.0, gate=True, takes_hold=True,
            done=Within(held, hole, precision, heights[0] + precision, tool=tip), hold=1 / 15, timeout=1.5,
            failure=f"lost {hole}", fails=fails,
        ),
        Phase(
            "enter", Mode.IK, low, width=0.0, gate=True,
            done=entered, timeout=0.8, failure=f"missed {hole}", fails=fails,
        ),
        Phase(
            "insert", Mode.IK, lowest, width=0.0, gate=True,
            done=inside, timeout=0.8, failure="jammed", fails=fails,
        ),
        Phase(
            "release", Mode.IK, lowest, width=0.08, gate=True,
            done=All((inside, Released(held))), hold=0.25, timeout=1.2, failure="not released",
        ),
    )  # fmt: skip
