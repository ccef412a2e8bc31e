"""Predicates about forces: what presses on an object, and how hard."""

from __future__ import annotations

from dataclasses import dataclass

from dynaforge.geometry import Pose
from dynaforge.sim.contacts import NO_PRESS
from dynaforge.tasks.view import PhaseView
from dynaforge.tasks.words import ObjectName, Size

DEEP = 0.002
"""Overlap beyond which two bodies are inside each other, metres; a firm grip overlaps by 0.1 to 0.4 mm."""
OPPOSED = 0.7
"""Least share of a finger's force that points toward the other finger: within 45 degrees, more inward than aside.
An object that is pressed more askew is squeezed out, or only lies on the fingers."""
GRIP = 5.0
"""Newtons with which each finger must press. At a friction of 0.5, 4 N hold the heaviest object, 0.4 kg."""


@dataclass(frozen=True, slots=True)
class Gripped:
    """Each finger presses the object toward the other finger, with no deep overlap.

    Attributes:
        object: The object.
        force: The least force of each finger toward the other, newtons.
    """

    object: ObjectName
    force: Size = GRIP

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        contacts = view.state.contacts
        presses = contacts.fingers.get(self.object, NO_PRESS)
        return contacts.depths.get(self.object, 0.0) <= DEEP and all(
            press.inward >= max(self.force, OPPOSED * press.force) for press in presses
        )


@dataclass(frozen=True, slots=True)
class Gently:
    """The robot presses on the object, and on the fixture that it is part of, with at most `limit` newtons in all."""

    object: ObjectName
    limit: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return view.state.contacts.robot_force(self.object) <= self.limit


@dataclass(frozen=True, slots=True)
class Struck:
    """The robot presses on the object other than with its fingers, or on another part of a fixture.

    It tells a click of the fingertips from one by the palm or with a push against the housing, which is no success. It
    ends no episode: a real robot does not stop at a brush, and a hard blow trips the force reflex in every task.
    """

    object: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return view.state.contacts.knocks.get(self.object, 0.0) > 0.0


@dataclass(frozen=True, slots=True)
class SupportedBy:
    """The other object presses on this free body, with no deep overlap."""

    object: ObjectName
    other: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        contacts = view.state.contacts
        return (self.object, self.other) in contacts.supports and contacts.depths.get(self.object, 0.0) <= DEEP
