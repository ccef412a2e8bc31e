"""Words for what must hold: adjectives over a view of the scene."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import Protocol

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim.checks import check_callable, shown
from dynaforge.tasks.view import PhaseView
from dynaforge.tasks.words import ObjectName, Size

__all__ = [
    "Aligned",
    "All",
    "Around",
    "AtRestOn",
    "Clicked",
    "Departed",
    "Fallen",
    "Grasped",
    "Lifted",
    "Narrowed",
    "Near",
    "Not",
    "OnTable",
    "Predicate",
    "Reached",
    "Released",
    "RobotStopped",
    "Touched",
    "Upright",
    "Within",
]


SUCH_AS = 'a predicate, such as Grasped("can")'


class Predicate(Protocol):
    """Reads a view and the phase's current target `T_world_ee`."""

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        """Tell whether it holds now."""
        ...


@dataclass(frozen=True, slots=True)
class All:
    """Every one of `parts` holds."""

    parts: tuple[Predicate, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.parts, (tuple, list)) or not self.parts:
            raise ValueError(
                f"All: parts is {shown(self.parts)}; it must be a tuple of predicates: All((Reached(0.03),))."
            )
        for part in self.parts:
            check_callable("All: one of parts", part, such_as=SUCH_AS)
        object.__setattr__(self, "parts", tuple(self.parts))

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return all(part(view, target) for part in self.parts)


@dataclass(frozen=True, slots=True)
class Not:
    """`part` does not hold."""

    part: Predicate

    def __post_init__(self) -> None:
        check_callable("Not: part", self.part, such_as=SUCH_AS)

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return not self.part(view, target)


@dataclass(frozen=True, slots=True)
class RobotStopped:
    """The robot stopped itself because a joint became too fast."""

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return view.state.stopped


@dataclass(frozen=True, slots=True)
class Reached:
    """The hand is within `distance` metres of the target."""

    distance: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return math.dist(view.state.ee.position, target.position) <= self.distance


@dataclass(frozen=True, slots=True)
class Near:
    """The object is within `distance` metres of the hand, measured on the plane."""

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
class Aligned:
    """The hand is above the object.

    Attributes:
        object: The object.
        along: Within so many metres along its heading.
        across: Within so many metres across it; None: as `along`, which then bounds the distance on the plane.
        height: The end effector is no more than this above the object's origin, metres.
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
    """A finger touches the object."""

    object: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return any(view.state.touching[self.object])


@dataclass(frozen=True, slots=True)
class Grasped:
    """Both fingers touch the object."""

    object: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return all(view.state.touching[self.object])


@dataclass(frozen=True, slots=True)
class Released:
    """No finger touches the object."""

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
class Within:
    """A point of the held object stands over or inside another object.

    Attributes:
        held: Whose point it is.
        object: The other object.
        distance: Of the point from the vertical axis through the other's origin, metres, at most.
        height: Of the point above the other's origin, metres, at most.
        tool: The point in the frame of `held`, metres.
    """

    held: ObjectName
    object: ObjectName
    distance: Size
    height: float
    _: KW_ONLY
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        point = view.state.objects[self.held].pose.apply(np.array(self.tool))
        x, y, z = (point - view.state.objects[self.object].pose.position).tolist()
        return math.hypot(x, y) <= self.distance and z <= self.height


@dataclass(frozen=True, slots=True)
class Upright:
    """The object's z axis is within `tilt` radians of the vertical, either way up."""

    object: ObjectName
    tilt: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return abs(float(view.state.objects[self.object].pose.rotation[2, 2])) >= math.cos(self.tilt)


@dataclass(frozen=True, slots=True)
class AtRestOn:
    """The object moves with another one: their speeds differ by at most `speed` m/s where it is."""

    object: ObjectName
    other: ObjectName
    speed: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        body, carrier = view.state.objects[self.object], view.state.objects[self.other]
        arm = body.pose.position - carrier.pose.position
        relative = body.velocity - carrier.velocity - np.cross(carrier.angular_velocity, arm)
        return float(relative @ relative) <= self.speed * self.speed


@dataclass(frozen=True, slots=True)
class Clicked:
    """A closed fingertip presses the middle of a button past its click point.

    Attributes:
        button: The fixture whose spring holds the button.
        travel: How far the button must be pressed in, metres.
        off_centre: Of the hand's axis from the button's, metres, at most.
        width: Of the opening between the fingers, metres, at most.
    """

    button: ObjectName
    travel: Size
    off_centre: Size
    width: Size = 0.005

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        state = view.state
        closed = state.width <= self.width and any(state.touching[self.button])
        return (
            closed
            and state.pressed[self.button] >= self.travel
            and (plane_distance(view, self.button) <= self.off_centre)
        )


@dataclass(frozen=True, slots=True)
class OnTable:
    """The object touches the table."""

    object: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return view.state.on_table[self.object]


@dataclass(frozen=True, slots=True)
class Lifted:
    """The object is `height` metres above where it started."""

    object: ObjectName
    height: float

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        start = view.start.objects[self.object].pose.position[2]
        return bool(view.state.objects[self.object].pose.position[2] - start >= self.height)


@dataclass(frozen=True, slots=True)
class Fallen:
    """The object is more than `depth` metres below the table top."""

    object: ObjectName
    depth: float = 0.05

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return bool(view.state.objects[self.object].pose.position[2] < -self.depth)


@dataclass(frozen=True, slots=True)
class Departed:
    """The object is outside the disc of `reach` metres around the robot's base and moves away from it."""

    object: ObjectName
    reach: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        body = view.state.objects[self.object]
        x, y, _ = body.pose.position.tolist()
        vx, vy, _ = body.velocity.tolist()
        return bool(x * x + y * y > self.reach * self.reach and x * vx + y * vy >= 0.0)


def plane_distance(view: PhaseView, name: str) -> float:
    """Distance between hand and object on the plane, metres."""
    hand, thing = view.state.ee.position, view.state.objects[name].pose.position
    return math.hypot(float(hand[0] - thing[0]), float(hand[1] - thing[1]))
