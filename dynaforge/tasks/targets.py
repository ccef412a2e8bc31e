"""Words for where the hand should be: object-centric targets of Eq. 3."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynaforge.geometry import Array, Pose
from dynaforge.tasks.view import PhaseView


class Target(Protocol):
    """Turns a view into the desired end-effector pose `T_world_ee`."""

    @property
    def object(self) -> str:
        """Name of the reference object O."""
        ...

    def __call__(self, view: PhaseView) -> Pose:
        """Return `T_world_ee`."""
        ...


# Hand pointing down, fingers opening along x of the object frame: columns are the axes of ee in the object frame.
DOWN_ALONG_X = np.array(((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))


@dataclass(frozen=True, slots=True)
class Above:
    """Eq. 3: `T_world_ee = T_world_object @ T_object_ee`, the hand straight above, closing along the heading.

    Attributes:
        object: The reference object O.
        height: Of the end effector above the object's centre, metres.
    """

    object: str
    height: float

    def __call__(self, view: PhaseView) -> Pose:
        frame = view.frames[self.object]
        position = frame.position + (0.0, 0.0, self.height)
        if view.lead_time:
            position = position + view.lead_time * view.state.objects[self.object].velocity
        return Pose(nearer_half_turn(frame.rotation @ DOWN_ALONG_X, view.entry.ee.rotation), position)


@dataclass(frozen=True, slots=True)
class Downstream:
    """Meet the object: a pose fixed in its heading frame at phase entry, on its line and ahead of it.

    The meeting point is where the object's line enters the robot's reach, so that a fast object is met as early as
    can be and the whole reach is left to run along with it. It is geometry only: speed plays no part.

    Attributes:
        object: The reference object O.
        height: Of the end effector above the object's centre, metres.
        reach: Radius of the disc around the robot's base in which objects can be handled, metres.
        clearance: The point is at least this far ahead of the object, metres.
    """

    object: str
    height: float
    reach: float
    clearance: float

    def __call__(self, view: PhaseView) -> Pose:
        frame = view.entry_frames[self.object]
        ahead = max(self.clearance, distance_to_disc(frame, self.reach))
        position = frame.apply(np.array((ahead, 0.0, self.height)))
        return Pose(nearer_half_turn(frame.rotation @ DOWN_ALONG_X, view.entry.ee.rotation), position)


@dataclass(frozen=True, slots=True)
class Raised:
    """Straight up from where the hand was at phase entry.

    Attributes:
        object: The object that is carried.
        height: Metres above the hand's pose at phase entry.
    """

    object: str
    height: float

    def __call__(self, view: PhaseView) -> Pose:
        return Pose(view.entry.ee.rotation, view.entry.ee.position + (0.0, 0.0, self.height))


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
