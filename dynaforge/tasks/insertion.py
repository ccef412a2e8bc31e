"""Insertion: phases in which the planner takes an object out of a rack and puts it into a moving hole."""

from __future__ import annotations

from functools import partial

from dynaforge.sim.hand_target import TIP
from dynaforge.tasks.phase import REDUCED_SPEED, Ending, Mode, Phase
from dynaforge.tasks.predicates import All, Around, Grasped, Lifted, Predicate, Reached, Released, SupportedBy, Within
from dynaforge.tasks.targets import Above, Grip, Over, Raised

Point = tuple[float, float, float]


def rack_pick_phases(grasped: str, *, grip: float, precision: float, lift: float, clear: float) -> tuple[Phase, ...]:
    """Return the phases that reach over an upright object, go down, close the hand and lift.

    The pose of the object in the hand is measured at the end.

    Args:
        grasped: The object.
        grip: Height of the hand above the object's middle when it closes, metres.
        precision: How near to its target the hand must come before it closes, metres.
        lift: How far the hand goes up, metres.
        clear: How far the object must have gone up, metres.
    """
    above, around = Above(grasped, grip + 0.05, Grip.KEPT), Above(grasped, grip, Grip.KEPT)
    lifted = All((Lifted(grasped, clear), Grasped(grasped)))
    return (
        Phase("reach", Mode.GLOBAL, above, width=0.04, done=Reached(0.015), timeout=2.0, failure="not reached"),
        Phase(
            "descend",
            Mode.IK,
            around,
            width=0.04,
            done=Reached(precision),
            ramp=REDUCED_SPEED,
            timeout=1.0,
            failure="not reached",
        ),
        Phase(
            "close",
            Mode.IK,
            around,
            width=0.0,
            done=Grasped(grasped),
            hold=0.1,
            timeout=0.8,
            failure="missed close",
        ),
        Phase(
            "lift",
            Mode.GLOBAL,
            Raised(grasped, lift),
            width=0.0,
            takes_hold=True,
            done=lifted,
            timeout=1.5,
            failure="slipped",
        ),
    )


def insertion_phases(
    grasped: str,
    hole: str,
    tip: Point,
    *,
    grip: float,
    rim: float,
    heights: tuple[float, float, float],
    precision: float,
    entered: Predicate,
    inside: Predicate,
    fails: tuple[Ending, ...],
) -> tuple[Phase, ...]:
    """Return the phases that carry an object over a moving hole, follow it, put the tip in, go down and let go.

    The closing fingers centre the object slowly, so its pose in the hand is measured again at the end of each phase
    above the hole.

    Args:
        grasped: The object.
        hole: What it goes into; its frame is in the middle of its floor.
        tip: The end of the object that goes in first, in the object's frame, metres.
        grip: Height of the hand above the object's middle while it holds it, metres.
        rim: Height of the hole's rim above the floor, metres; the fingertips stay 4 mm above it.
        heights: Height of the tip above the floor while it waits, once it has entered, and at the end, metres.
        precision: How near the tip must come to its place above the hole before it goes down, metres.
        entered: The tip is in the mouth of the hole.
        inside: The object is where it belongs.
        fails: The ways in which the hand may lose the object.
    """
    hover, low, lowest = (Over(hole, grasped, height, tool=tip, upright=True) for height in heights)
    aligned = Within(grasped, hole, precision, heights[0] + precision, tool=tip)
    above = rim + 0.004 + TIP
    # The hand lets go with the tip at the last height and stays: dropped in from above the mouth, it would be farther.
    released = All((inside, SupportedBy(grasped, hole), Released(grasped), Around(grasped, grip + heights[2] + 0.02)))
    down = partial(
        Phase,
        mode=Mode.IK,
        width=0.0,
        gate=True,
        lowest=above,
        ramp=REDUCED_SPEED,
        timeout=0.8,
        fails=fails,
    )
    return (
        *_carry_and_align(hole, hover, lowest=above, aligned=aligned, fails=fails),
        down("enter", target=low, done=entered, failure=f"missed {hole}"),
        down("insert", target=lowest, done=inside, failure="jammed"),
        Phase(
            "release",
            Mode.IK,
            lowest,
            width=0.08,
            gate=True,
            lowest=above,
            done=released,
            hold=0.25,
            timeout=1.2,
            failure="not released",
        ),
    )


def _carry_and_align(
    hole: str, hover: Over, *, lowest: float, aligned: Predicate, fails: tuple[Ending, ...]
) -> tuple[Phase, ...]:
    """Return the phases that carry the grasped object over the hole and follow the hole until the tip is above it."""
    return (
        Phase(
            "carry",
            Mode.GLOBAL,
            hover,
            width=0.0,
            takes_hold=True,
            lowest=lowest,
            done=Reached(0.02),
            timeout=2.0,
            failure="not carried",
            fails=fails,
        ),
        Phase(
            "align",
            Mode.IK,
            hover,
            width=0.0,
            gate=True,
            takes_hold=True,
            lowest=lowest,
            done=aligned,
            hold=1 / 15,
            timeout=1.5,
            failure=f"lost {hole}",
            fails=fails,
        ),
    )
