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
        floor: Smallest height of the point above the other object's origin, metres.
        tool: The point in the frame of `held`, metres.
    """

    held: ObjectName
    object: ObjectName
    distance: Size
    height: float
    _: KW_ONLY
    floor: float = -math.inf
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        point = view.state.objects[self.held].pose.apply(np.array(self.tool))
        x, y, z = (point - view.state.objects[self.object].pose.position).tolist()
        return math.hypot(x, y) <= self.distance and self.floor <= z <= self.height


@dataclass(frozen=True, slots=True)
class Upright:
    """An axis of the object is vertical, either way up.

    Attributes:
        object: The object.
        tilt: Largest angle between the axis and the vertical, radians.
        any_face: Whether any of the three axes will do, as of a cube that stands on any of its faces; otherwise it is
            the z axis.
    """

    object: ObjectName
    tilt: Size
    any_face: bool = False

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        up = np.abs(view.state.objects[self.object].pose.rotation[2])
        return bool((up.max() if self.any_face else up[2]) >= math.cos(self.tilt))


@dataclass(frozen=True, slots=True)
class FootOn:
    """No part of an object that stands on a square plate hangs over its edges.

    Attributes:
        object: The object, a cube.
        other: The plate; its frame is in the middle, its edges along its x and y axes.
        half: Half the edge length of the cube, metres.
        plate: Half the edge length of the plate, metres.
    """

    object: ObjectName
    other: ObjectName
    half: Size
    plate: Size

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        cube = view.state.objects[self.other].pose.inverse() @ view.state.objects[self.object].pose
        reach = np.abs(cube.position) + self.half * np.abs(cube.rotation).sum(axis=1)
        return bool((reach[:2] <= self.plate).all())


@dataclass(frozen=True, slots=True)
class AtRestOn:
    """The object moves and turns with another one.

    Attributes:
        object: The object.
        other: The other one, which carries it.
        speed: Largest difference of their velocities at the object's place, m/s.
        spin: Largest difference of their angular velocities, rad/s. A ball of 3 cm that rolls at 5 cm/s turns at 1.6.
    """

    object: ObjectName
    other: ObjectName
    speed: Size
    spin: Size = 2.0

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        body, carrier = view.state.objects[self.object], view.state.objects[self.other]
        offset = body.pose.position - carrier.pose.position
        relative = body.velocity - carrier.velocity - np.cross(carrier.angular_velocity, offset)
        turning = body.angular_velocity - carrier.angular_velocity
        return bool(relative @ relative <= self.speed * self.speed and turning @ turning <= self.spin * self.spin)


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
