"""Predicates about the objects: where they are, how they stand and how they move."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.tasks.view import PhaseView
from dynaforge.tasks.words import ObjectName, Size


@dataclass(frozen=True, slots=True)
class Within:
    """A point of the grasped object is over or inside another object.

    Attributes:
        held: The grasped object, to which the point belongs.
        object: The other object.
        distance: Largest distance of the point from the vertical axis through the other object's origin, metres.
        height: Largest height of the point above the other object's origin, metres.
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
    """The object moves with another one: at its place their velocities differ by at most `speed` m/s."""

    object: ObjectName
    other: ObjectName
    speed: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        body, carrier = view.state.objects[self.object], view.state.objects[self.other]
        offset = body.pose.position - carrier.pose.position
        relative = body.velocity - carrier.velocity - np.cross(carrier.angular_velocity, offset)
        return float(relative @ relative) <= self.speed * self.speed


@dataclass(frozen=True, slots=True)
class OnTable:
    """The object touches the table."""

    object: ObjectName

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return view.state.on_table[self.object]


@dataclass(frozen=True, slots=True)
class Lifted:
    """The object is at least `height` metres above where it started."""

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
