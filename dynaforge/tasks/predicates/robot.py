"""Predicates about the robot: where its hand is, what its fingers touch, whether it has stopped."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dynaforge.geometry import Pose
from dynaforge.tasks.view import PhaseView
from dynaforge.tasks.words import ObjectName, Size


@dataclass(frozen=True, slots=True)
class RobotStopped:
    """The robot has stopped itself because a joint exceeded its speed limit."""

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return view.state.stopped


@dataclass(frozen=True, slots=True)
class Overloaded:
    """The robot has stopped itself because something pushed against it too hard."""

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return view.state.overloaded


@dataclass(frozen=True, slots=True)
class Reached:
    """The hand is within `distance` metres of the target."""

    distance: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return math.dist(view.state.ee.position, target.position) <= self.distance


@dataclass(frozen=True, slots=True)
class Near:
    """The object is within `distance` metres of the hand, measured in the horizontal plane."""

    object: ObjectName
    distance: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return plane_distance(view, self.object) <= self.distance


@dataclass(frozen=True, slots=True)
class Around:
    """The object's origin is within `distance` metres of the end effector."""

    object: ObjectName
    distance: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return math.dist(view.state.ee.position, view.state.objects[self.object].pose.position) <= self.distance


@dataclass(frozen=True, slots=True)
class Between:
    """The object's origin is between the finger pads, not above or below them: it cannot lie on the fingers.

    Attributes:
        object: The object.
        breadth: Largest distance of its origin from the middle of the pads, along their breadth, metres; by default
            half their breadth.
    """

    object: ObjectName
    breadth: Size = 0.010

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        hand = view.state.ee
        offset = view.state.objects[self.object].pose.position - hand.position
        return bool(abs(offset @ hand.rotation[:, 0]) <= self.breadth)


@dataclass(frozen=True, slots=True)
class Aligned:
    """The hand is above the object.

    Attributes:
        object: The object.
        along: Largest distance along the object's heading, metres.
        across: Largest distance across the heading, metres; None: `along` bounds the distance in the horizontal plane.
        height: Largest height of the end effector above the object's origin, metres.
    """

    object: ObjectName
    along: Size
    across: Size | None = None
    height: float = math.inf

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        frame = view.frames[self.object]
        x, y, z = ((view.state.ee.position - frame.position) @ frame.rotation).tolist()
        if z > self.height:
            return False
        if self.across is None:
            return math.hypot(x, y) <= self.along
        return bool(abs(x) <= self.along and abs(y) <= self.across)


@dataclass(frozen=True, slots=True)
class Touched:
    """A finger presses on the object, however lightly."""

    object: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return any(view.state.touching[self.object])


@dataclass(frozen=True, slots=True)
class Grasped:
    """Both fingers press on the object, however lightly."""

    object: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return all(view.state.touching[self.object])


@dataclass(frozen=True, slots=True)
class Released:
    """No finger presses on the object."""

    object: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return not any(view.state.touching[self.object])


@dataclass(frozen=True, slots=True)
class Narrowed:
    """The opening between the fingers is at most `width` metres."""

    width: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return bool(view.state.width <= self.width)


@dataclass(frozen=True, slots=True)
class Clicked:
    """Closed fingertips press the middle of a button past its click point.

    Attributes:
        button: The fixture that has the button and its spring.
        travel: How far the button must be pressed in, metres.
        off_centre: Largest distance of the hand's axis from the button's, metres.
        width: Largest opening between the fingers, metres.
        tilt: Largest angle between the hand's axis and the button's, radians; beyond, a finger's side presses.
    """

    button: ObjectName
    travel: Size
    off_centre: Size
    width: Size = 0.002
    tilt: Size = 0.3

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        state = view.state
        if state.width > self.width or not any(state.touching[self.button]):
            return False
        straight = float(state.ee.rotation[:, 2] @ -state.objects[self.button].pose.rotation[:, 2])
        return (
            state.pressed[self.button] >= self.travel
            and plane_distance(view, self.button) <= self.off_centre
            and straight >= math.cos(self.tilt)
        )


def plane_distance(view: PhaseView, name: str) -> float:
    """Return the distance between hand and object in the horizontal plane, metres."""
    hand, body = view.state.ee.position, view.state.objects[name].pose.position
    return math.hypot(float(hand[0] - body[0]), float(hand[1] - body[1]))
