"""Targets, the words for where the hand should be: object-centric, as in Eq. 3."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from dynaforge.geometry import Array, Pose, matrix_from_rotvec, rotation_z
from dynaforge.tasks.reach import along_arc, arc_to_disc, distance_to_disc
from dynaforge.tasks.view import PhaseView, yaw
from dynaforge.tasks.words import ObjectName, Size

__all__ = [
    "Above",
    "Catching",
    "Downstream",
    "DownstreamArc",
    "Grip",
    "Over",
    "Pressing",
    "Raised",
    "Target",
]


class Target(Protocol):
    """The desired end-effector pose `T_world_ee` as a function of the view."""

    @property
    def object(self) -> str:
        """Name of the reference object O."""
        ...

    def __call__(self, view: PhaseView) -> Pose:
        """Return `T_world_ee`."""
        ...


class Grip(StrEnum):
    """How the fingers of a hand that points down are turned with respect to an object.

    ALONG, ACROSS: they open along or across its heading. FACES: they close on that pair of faces of an upright box
    which needs the smaller turn. KEPT: as at phase entry.
    """

    ALONG = "along"
    ACROSS = "across"
    FACES = "faces"
    KEPT = "kept"


# The hand points down and its fingers open along x (or y) of the object frame, in which the columns are the axes of ee.
DOWN_ALONG_X = np.array(((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
DOWN_ALONG_Y = np.diag((1.0, -1.0, -1.0))
HALF_TURN: Array = np.array((-1.0, -1.0, 1.0))  # about the hand's axis: factors of the columns of its rotation


def hand_rotation(view: PhaseView, frame: Pose, name: str, grip: Grip) -> Array:
    """Return the rotation of a hand that points down and grips an object.

    Of grasps that differ only by a symmetry of the object, it is the one nearest to the hand at phase entry.

    Args:
        view: The scene.
        frame: Heading frame of the object.
        name: The object.
        grip: How the fingers are turned.
    """
    current = view.entry.ee.rotation
    if grip is Grip.KEPT:
        return straight_down(current)
    if grip is Grip.FACES:
        first = rotation_z(yaw(view.state.objects[name].pose)) @ DOWN_ALONG_X
        other = first @ rotation_z(math.pi / 2)
        candidates = (nearer_half_turn(first, current), nearer_half_turn(other, current))
        return max(candidates, key=lambda rotation: float(np.vdot(rotation, current)))
    down = DOWN_ALONG_X if grip is Grip.ALONG else DOWN_ALONG_Y
    return nearer_half_turn(frame.rotation @ down, current)


@dataclass(frozen=True, slots=True)
class Above:
    """Eq. 3: `T_world_ee = T_world_object @ T_object_ee`, with the hand straight above the object.

    Attributes:
        object: The reference object O.
        height: Height of the end effector above the object's origin, metres.
        grip: How the fingers are turned.
    """

    object: ObjectName
    height: float
    grip: Grip = Grip.ALONG

    def __call__(self, view: PhaseView) -> Pose:
        frame = view.frames[self.object]
        position = predicted_position(view, self.object) + (0.0, 0.0, self.height)
        return Pose(hand_rotation(view, frame, self.object, self.grip), position)


@dataclass(frozen=True, slots=True)
class Pressing:
    """The hand presses a button: straight above it, the end effector at a height that does not sink with the button.

    A target that sinks with the button would go down to the stop and press on what carries it.

    Attributes:
        object: The fixture with the button and its spring.
        height: Height of the end effector above the button's origin while nothing presses it, metres.
        grip: How the fingers are turned.
    """

    object: ObjectName
    height: float
    grip: Grip = Grip.KEPT

    def __call__(self, view: PhaseView) -> Pose:
        return Above(self.object, self.height + view.state.pressed[self.object], self.grip)(view)


@dataclass(frozen=True, slots=True)
class Downstream:
    """Meet the object: a pose ahead of it on its line, fixed in its heading frame at phase entry.

    The meeting point is where the line enters the robot's reach. A fast object is thus met as early as possible, and
    the hand can move along with it through the whole reach. The point follows from geometry alone, not from the speed.

    Attributes:
        object: The reference object O.
        height: Height of the end effector above the object's origin, metres.
        reach: Radius of the disc around the robot's base in which objects can be handled, metres.
        clearance: Least distance of the point ahead of the object, metres.
        grip: How the fingers are turned.
        live: Whether to use the current heading frame at every control step, for objects that do not roll straight.
    """

    object: ObjectName
    height: float
    _: KW_ONLY
    reach: Size
    clearance: float
    grip: Grip = Grip.ALONG
    live: bool = False

    def __call__(self, view: PhaseView) -> Pose:
        frame = (view.frames if self.live else view.entry_frames)[self.object]
        ahead = max(self.clearance, distance_to_disc(frame, self.reach))
        position = frame.apply(np.array((ahead, 0.0, self.height)))
        return Pose(hand_rotation(view, frame, self.object, self.grip), position)


@dataclass(frozen=True, slots=True)
class DownstreamArc:
    """Meet a tapered object that rolls in a circle: like `Downstream`, along an arc instead of a line.

    The object turns toward its thin end, to which its z axis points.

    Attributes:
        object: The reference object O.
        height: Height of the end effector above the object's origin, metres.
        reach: Radius of the disc around the robot's base in which objects can be handled, metres.
        clearance: Least distance of the point ahead of the object along the arc, metres.
        radius: Radius of the circle on which the object's origin moves, metres.
        grip: How the fingers are turned.
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
    """Wait for an object that leaves a fixture: a pose fixed in the fixture's frame, moved sideways with the object.

    The object comes along the fixture's x axis. The hand points the opposite way, and its fingers open sideways.

    Attributes:
        object: The object that comes.
        fixture: The fixture in whose frame the pose is fixed.
        ahead: Position of the end effector along the fixture's x axis, metres.
        height: Position of the end effector along the fixture's z axis, metres.
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
        sideways = float(base.inverse().apply(predicted_position(view, self.object))[1])
        c, s = math.cos(self.pitch), math.sin(self.pitch)
        z, y = np.array((-c, 0.0, s)), np.array((0.0, -1.0, 0.0))
        local = Pose(np.column_stack((np.cross(y, z), y, z)), np.array((self.ahead, sideways, self.height)))
        return base @ local


@dataclass(frozen=True, slots=True)
class Over:
    """Bring the grasped object over another one: Eq. 3 for the tool frame, whose pose in the hand the grasp measured.

    Attributes:
        object: The reference object O, over which the grasped object is brought.
        held: The grasped object.
        height: Height of the tool point above the reference object's origin, metres.
        tool: The tool point in the grasped object's frame, metres.
        upright: Whether the hand turns so that the grasped object's z axis is vertical.
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
        tool_in_world = predicted_position(view, self.object) + (0.0, 0.0, self.height)
        return Pose(rotation, tool_in_world - rotation @ tool_in_ee)


@dataclass(frozen=True, slots=True)
class Raised:
    """Straight up from where the hand was at phase entry.

    Attributes:
        object: The reference object O: the grasped object, or the one just released.
        height: Height above the hand's pose at phase entry, metres.
    """

    object: ObjectName
    height: float

    def __call__(self, view: PhaseView) -> Pose:
        return Pose(view.entry.ee.rotation, view.entry.ee.position + (0.0, 0.0, self.height))


def predicted_position(view: PhaseView, name: str) -> Array:
    """Return an object's position in the world frame, metres; with a lead time, where constant velocity takes it."""
    body = view.state.objects[name]
    return body.pose.position + view.lead_time * body.velocity if view.lead_time else body.pose.position


def straight_down(rotation: Array) -> Array:
    """Return the nearest rotation of a hand that points straight down; the fingers keep their horizontal direction."""
    x, y, _ = rotation[:, 1].tolist()
    straight: Array = rotation_z(math.atan2(y, x) - math.pi / 2) @ (DOWN_ALONG_Y * HALF_TURN)
    return straight


def upright_rotation(axis: Array) -> Array:
    """Return the least rotation, shape (3, 3), that makes a unit axis vertical, up or down, whichever is nearer."""
    up = np.array((0.0, 0.0, math.copysign(1.0, axis[2])))
    sine = np.cross(axis, up)
    n = float(np.linalg.norm(sine))
    return np.eye(3) if n < 1e-9 else matrix_from_rotvec(sine * (math.atan2(n, float(axis @ up)) / n))


def nearer_half_turn(rotation: Array, current: Array) -> Array:
    """Return a grasp's rotation, or that turned by pi about the hand's axis, whichever is nearer to `current`."""
    turned = rotation * HALF_TURN
    return turned if np.vdot(turned, current) > np.vdot(rotation, current) else rotation
