"""Words for what must hold: adjectives over a view of the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from dynaforge.geometry import Pose
from dynaforge.tasks.view import PhaseView


class Predicate(Protocol):
    """Reads a view and the phase's current target `T_world_ee`."""

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        """Tell whether it holds now."""
        ...


@dataclass(frozen=True, slots=True)
class All:
    """Every one of `parts` holds."""

    parts: tuple[Predicate, ...]

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return all(part(view, target) for part in self.parts)


@dataclass(frozen=True, slots=True)
class Reached:
    """The hand is within `distance` metres of the target."""

    distance: float

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return math.dist(view.state.ee.position, target.position) <= self.distance


@dataclass(frozen=True, slots=True)
class Near:
    """The object is within `distance` metres of the hand, measured on the plane."""

    object: str
    distance: float

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return plane_distance(view, self.object) <= self.distance


@dataclass(frozen=True, slots=True)
class Aligned:
    """The hand is above the object: within `distance` metres on the plane, and `height` metres above its centre."""

    object: str
    distance: float
    height: float = math.inf

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        if plane_distance(view, self.object) > self.distance:
            return False
        above = view.state.ee.position[2] - view.state.objects[self.object].pose.position[2]
        return bool(above <= self.height)


@dataclass(frozen=True, slots=True)
class Touched:
    """A finger touches the object."""

    object: str

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return any(view.state.touching[self.object])


@dataclass(frozen=True, slots=True)
class Grasped:
    """Both fingers touch the object."""

    object: str

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return all(view.state.touching[self.object])


@dataclass(frozen=True, slots=True)
class Lifted:
    """The object is `height` metres above where it started."""

    object: str
    height: float

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        start = view.start.objects[self.object].pose.position[2]
        return bool(view.state.objects[self.object].pose.position[2] - start >= self.height)


@dataclass(frozen=True, slots=True)
class Fallen:
    """The object is more than `depth` metres below the table top."""

    object: str
    depth: float = 0.05

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return bool(view.state.objects[self.object].pose.position[2] < -self.depth)


@dataclass(frozen=True, slots=True)
class Departed:
    """The object is outside the disc of `reach` metres around the robot's base and moves away from it."""

    object: str
    reach: float

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        body = view.state.objects[self.object]
        x, y, _ = body.pose.position.tolist()
        vx, vy, _ = body.velocity.tolist()
        return bool(x * x + y * y > self.reach * self.reach and x * vx + y * vy >= 0.0)


def plane_distance(view: PhaseView, name: str) -> float:
    """Distance between hand and object on the plane, metres."""
    hand, thing = view.state.ee.position, view.state.objects[name].pose.position
    return math.hypot(float(hand[0] - thing[0]), float(hand[1] - thing[1]))
