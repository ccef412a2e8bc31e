"""Words for where the hand should be: object-centric targets of Eq. 3."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from dynaforge.geometry import Array, Pose, matrix_from_rotvec, rotation_z
from dynaforge.tasks.view import PhaseView, yaw
from dynaforge.tasks.words import ObjectName, Size

__all__ = [
    "Above",
    "Catching",
    "Downstream",
    "DownstreamArc",
    "Grip",
    "Over",
    "Raised",
    "Target",
]


class Target(Protocol):
    """Turns a view into the desired end-effector pose `T_world_ee`."""

    @property
    def object(self) -> str:
        """Name of the reference object O."""
        ...

    def __call__(self, view: PhaseView) -> Pose:
        """Return `T_world_ee`."""
        ...


class Grip(StrEnum):
    """How the fingers of a hand that points down stand to an object.

    ALONG, ACROSS: they open along or across its heading. FACES: they close on two faces of an upright box, the
    nearer pair. KEPT: as they stood at phase entry.
    """

    ALONG = "along"
    ACROSS = "across"
    FACES = "faces"
    KEPT = "kept"


# Hand pointing down, fingers opening along x (y) of the object frame: columns are the axes of ee in the object frame.
DOWN_ALONG_X = np.array(((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
DOWN_ALONG_Y = np.diag((1.0, -1.0, -1.0))


def hand_rotation(view: PhaseView, frame: Pose, name: str, grip: Grip) -> Array:
    """Return the rotation of a hand that points down and grips an object so; `frame` is its heading frame.

    Of grasps that differ by the object's symmetry, the one nearest to the hand at phase entry.
    """
    current = view.entry.ee.rotation
    if grip is Grip.KEPT:
        return straight_down(current)
    if grip is Grip.FACES:
        first = rotation_z(yaw(view.state.objects[name].pose)) @ DOWN_ALONG_X
        other = first @ rotation_z(math.pi / 2)
        return max((nearer_half_turn(r, current) for r in (first, other)), key=lambda r: float(np.vdot(r, current)))
    return nearer_half_turn(frame.rotation @ (DOWN_ALONG_X if grip is Grip.ALONG else DOWN_ALONG_Y), current)


@dataclass(frozen=True, slots=True)
class Above:
    """Eq. 3: `T_world_ee = T_world_object @ T_object_ee`, the hand straight above.

    Attributes:
        object: The reference object O.
        height: Of the end effector above the object's origin, metres.
        grip: How the fingers stand to it.
    """

    object: ObjectName
    height: float
    grip: Grip = Grip.ALONG

    def __call__(self, view: PhaseView) -> Pose:
        frame = view.frames[self.object]
        position = predicted_position(view, self.object) + (0.0, 0.0, self.height)
        return Pose(hand_rotation(view, frame, self.object, self.grip), position)


@dataclass(frozen=True, slots=True)
class Downstream:
    """Meet the object: a pose fixed in its heading frame at phase entry, on its line and ahead of it.

    The meeting point is where the object's line enters the robot's reach, so that a fast object is met as early as
    can be and the whole reach is left to run along with it. It is geometry only: speed plays no part.

    Attributes:
        object: The reference object O.
        height: Of the end effector above the object's origin, metres.
        reach: Radius of the disc around the robot's base in which objects can be handled, metres.
        clearance: The point is at least this far ahead of the object, metres.
        grip: How the fingers stand to it.
        live: Read the heading frame anew at every control step, for objects that do not roll straight.
    """

    object: ObjectName
    height: float
    reach: Size
    clearance: float
    grip: Grip = Grip.ALONG
    _: KW_ONLY
    live: bool = False

    def __call__(self, view: PhaseView) -> Pose:
        frame = (view.frames if self.live else view.entry_frames)[self.object]
        ahead = max(self.clearance, distance_to_disc(frame, self.reach))
        position = frame.apply(np.array((ahead, 0.0, self.height)))
        return Pose(hand_rotation(view, frame, self.object, self.grip), position)


@dataclass(frozen=True, slots=True)
class DownstreamArc:
    """Meet a tapered object that rolls in a circle: as `Downstream`, along its arc instead of a line.

    It turns to the side of its thin end, where its z axis points.

    Attributes:
        object: The reference object O.
        height: Of the end effector above the object's origin, metres.
        reach: Radius of the disc around the robot's base in which objects can be handled, metres.
        clearance: The point is at least this far ahead of the object, along its arc, metres.
        radius: Of the circle in which its origin rolls, metres.
        grip: How the fingers stand to it.
    """

    object: ObjectName
    height: float
    _: KW_ONLY
    reach: Size
    clearance: float
    radius: Size
    grip: Grip = Grip.ALONG

    def __call__(self, view: PhaseView) -> Pose:
        frame = view.entry_frames[self.object]
        thin_end = view.entry.objects[self.object].pose.rotation[:, 2]
        turn = math.copysign(self.radius, float(frame.rotation[:, 1] @ thin_end))
        frame = along_arc(frame, turn, max(self.clearance, arc_to_disc(frame, turn, self.reach)))
        return Pose(hand_rotation(view, frame, self.object, self.grip), frame.position + (0.0, 0.0, self.height))


@dataclass(frozen=True, slots=True)
class Catching:
    """Wait for an object that comes off a fixture: a pose fixed in the fixture's frame, moved sideways with the object.

    The hand faces against the fixture's x axis, along which the object comes, its fingers open sideways.

    Attributes:
        object: The object that comes.
        fixture: Whose frame the pose is fixed in.
        ahead: Of the end effector along the fixture's x axis, metres.
        height: Along its z axis, metres.
        pitch: How far the hand is pitched up, radians.
    """

    object: ObjectName
    fixture: ObjectName
    _: KW_ONLY
    ahead: float
    height: float
    pitch: float

    def __call__(self, view: PhaseView) -> Pose:
        base = view.state.objects[self.fixture].pose
        sideways = float((base.inverse().apply(predicted_position(view, self.object)))[1])
        c, s = math.cos(self.pitch), math.sin(self.pitch)
        z, y = np.array((-c, 0.0, s)), np.array((0.0, -1.0, 0.0))
        local = Pose(np.column_stack((np.cross(y, z), y, z)), np.array((self.ahead, sideways, self.height)))
        return base @ local


@dataclass(frozen=True, slots=True)
class Over:
    """Bring the held object over another: Eq. 3 for the tool frame, the object in the hand as measured at the grasp.

    Attributes:
        object: The reference object O, to be brought over.
        held: The object in the hand.
        height: Of the tool point above the reference object's origin, metres.
        tool: The tool point in the held object's frame, metres.
        upright: Turn the hand so that the held object's z axis is vertical.
    """

    object: ObjectName
    held: ObjectName
    height: float
    _: KW_ONLY
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)
    upright: bool = False

    def __call__(self, view: PhaseView) -> Pose:
        T_ee_grasped = view.T_ee_grasped(self.held)
        rotation = straight_down(view.entry.ee.rotation)
        if self.upright:
            rotation = upright_rotation(rotation @ T_ee_grasped.rotation[:, 2]) @ rotation
        tool_in_ee = T_ee_grasped.apply(np.array(self.tool))
        return Pose(rotation, predicted_position(view, self.object) + (0.0, 0.0, self.height) - rotation @ tool_in_ee)


@dataclass(frozen=True, slots=True)
class Raised:
    """Straight up from where the hand was at phase entry.

    Attributes:
        object: The reference object O: what is carried, or was put down.
        height: Metres above the hand's pose at phase entry.
    """

    object: ObjectName
    height: float

    def __call__(self, view: PhaseView) -> Pose:
        return Pose(view.entry.ee.rotation, view.entry.ee.position + (0.0, 0.0, self.height))


def predicted_position(view: PhaseView, name: str) -> Array:
    """Where an object is, metres, world frame; with a lead time, where constant velocity takes it."""
    body = view.state.objects[name]
    return body.pose.position + view.lead_time * body.velocity if view.lead_time else body.pose.position


def straight_down(rotation: Array) -> Array:
    """Turn a hand by the least so that it points straight down; its fingers keep their direction on the plane."""
    x, y, _ = rotation[:, 1].tolist()
    return rotation_z(math.atan2(y, x) - math.pi / 2) @ (DOWN_ALONG_Y * (-1.0, -1.0, 1.0))


def upright_rotation(axis: Array) -> Array:
    """Least rotation, shape (3, 3), that makes a unit axis vertical: upward or downward, whichever is nearer."""
    up = np.array((0.0, 0.0, math.copysign(1.0, axis[2])))
    sine = np.cross(axis, up)
    n = float(np.linalg.norm(sine))
    return np.eye(3) if n < 1e-9 else matrix_from_rotvec(sine * (math.atan2(n, float(axis @ up)) / n))


def nearer_half_turn(rotation: Array, current: Array) -> Array:
    """Of a grasp and the same grasp turned by pi about the hand's axis, return the one nearer to `current`."""
    turned = rotation * (-1.0, -1.0, 1.0)
    return turned if np.vdot(turned, current) > np.vdot(rotation, current) else rotation


def distance_to_disc(frame: Pose, radius: float) -> float:
    """Distance along x of `frame` to the disc of `radius` metres around the world's z axis.

    A line that misses the disc is met at its point nearest to the axis. Zero or less: already inside.
    """
    x, y = float(frame.position[0]), float(frame.position[1])
    ux, uy = float(frame.rotation[0, 0]), float(frame.rotation[1, 0])
    nearest = -(x * ux + y * uy)
    missed2 = radius * radius - (x * uy - y * ux) ** 2
    return nearest - math.sqrt(max(0.0, missed2))


def along_arc(frame: Pose, turn: float, distance: float) -> Pose:
    """Move `frame` by `distance` metres along the circle of radius |turn| that its x axis touches, left if positive."""
    turned = rotation_z(distance / turn)
    arm = frame.rotation @ (0.0, -turn, 0.0)
    return Pose(turned @ frame.rotation, frame.position - arm + turned @ arm)


def arc_to_disc(frame: Pose, turn: float, radius: float) -> float:
    """Distance along that circle to the disc of `radius` metres around the world's z axis, as `distance_to_disc`."""
    arm = frame.rotation @ (0.0, -turn, 0.0)
    centre = frame.position - arm
    away = math.hypot(float(centre[0]), float(centre[1]))
    ahead = math.atan2(-float(centre[1]), -float(centre[0])) - math.atan2(float(arm[1]), float(arm[0]))
    nearest = math.remainder(math.copysign(1.0, turn) * ahead, 2 * math.pi)
    cosine = (turn * turn + away * away - radius * radius) / (2 * abs(turn) * away)
    return abs(turn) * (nearest - math.acos(min(1.0, max(-1.0, cosine))))
