"""Who presses on whom, and how hard: what a snapshot of the scene says about contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

from dynaforge.geometry import Pose, one_line

if TYPE_CHECKING:  # snapshots are read where no physics engine is loaded
    from dynaforge.sim.bullet_scene import BulletScene


class Press(NamedTuple):
    """How a finger presses on an object.

    Attributes:
        force: Sum of the normal forces, newtons.
        inward: Its component toward the other finger, along the axis on which the fingers open, newtons.
    """

    force: float = 0.0
    inward: float = 0.0


NO_PRESS = (Press(), Press())


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Contacts:
    """Normal forces at the end of a control step, over its last substep, by the names of the scene.

    Bullet reports pairs whose shapes are up to some millimetres apart as contacts; here only what carries a force
    counts. A name that is absent touches nothing. Of a fixture, only its tracked link has the fixture's name.

    Attributes:
        fingers: How the left and the right finger press on an object.
        knocks: Force of the robot on an object other than by its fingers, or on another link of a fixture, newtons.
        supports: Force of another body, of a fixture or of the table ("table") on a free body, newtons, by the two
            names, the free body's first.
        depths: How deeply something overlaps with another body, metres, by its name; "robot" and "table" included.
    """

    fingers: Mapping[str, tuple[Press, Press]] = field(default_factory=dict)
    knocks: Mapping[str, float] = field(default_factory=dict)
    supports: Mapping[tuple[str, str], float] = field(default_factory=dict)
    depths: Mapping[str, float] = field(default_factory=dict)

    __repr__ = one_line

    def touching(self, name: str) -> tuple[bool, bool]:
        """Return whether the left and the right finger press on an object."""
        left, right = self.fingers.get(name, NO_PRESS)
        return left.force > 0.0, right.force > 0.0

    def robot_force(self, name: str) -> float:
        """Return the sum of the normal forces of the robot on an object and on the fixture it is part of, newtons."""
        left, right = self.fingers.get(name, NO_PRESS)
        return left.force + right.force + self.knocks.get(name, 0.0)


NO_CONTACTS = Contacts()


Found = Sequence[tuple[Any, ...]]
"""Contact points as Bullet returns them. The robot was loaded first and is always the first of two bodies."""


class ContactReader:
    """Reads the contacts of a scene.

    Args:
        scene: The scene in Bullet.
    """

    def __init__(self, scene: BulletScene) -> None:
        self._ask = scene.client.getContactPoints
        self._robot = scene.robot.body
        self._of_robot = partial(self._ask, self._robot)
        self._sides = {joint: side for side, joint in enumerate(scene.robot.fingers)}
        self._free = {body.body: name for name, body in scene.free.items()}
        self._names = self._free | {scene.table: "table"}
        self._tracked: dict[int, int] = {}
        for name, fixture in scene.fixtures.items():
            self._tracked |= fixture.tracked
            self._names |= dict.fromkeys(fixture.variants, name)

    def all(self) -> Found:
        """Return all contact points now."""
        found: Found = self._ask()
        return found

    def of_robot(self) -> Found:
        """Return the contact points now at the robot."""
        found: Found = self._of_robot()
        return found

    def read(self, found: Found, ee: Pose) -> Contacts:
        """Return what contact points say.

        Args:
            found: All contact points.
            ee: `T_world_ee`, whose y axis is the one on which the fingers open.
        """
        if not found:
            return NO_CONTACTS
        opening = ee.rotation[:, 1].tolist()
        fingers: dict[str, list[list[float]]] = {}
        knocks: dict[str, float] = {}
        supports: dict[tuple[str, str], float] = {}
        depths: dict[str, float] = {}
        for _, a, b, link_a, link_b, _, _, normal, distance, force, *_ in found:
            name, tracked = self._names[b], self._tracked.get(b, link_b) == link_b
            other = "robot" if a == self._robot else self._names[a]
            for deep in (name, other):
                if distance < -depths.get(deep, 0.0):
                    depths[deep] = -distance
            if force <= 0.0:
                continue
            if a != self._robot:
                if b in self._free and self._tracked.get(a, link_a) == link_a:
                    supports[name, other] = supports.get((name, other), 0.0) + force
                if a in self._free and tracked:
                    supports[other, name] = supports.get((other, name), 0.0) + force
            elif tracked and link_a in self._sides:
                side = self._sides[link_a]
                along = -force * _dot(normal, opening)  # the normal points from b to a
                press = fingers.setdefault(name, [[0.0, 0.0], [0.0, 0.0]])[side]
                press[0] += force
                press[1] += along if side else -along  # the left finger opens along +y
            else:
                knocks[name] = knocks.get(name, 0.0) + force
        return Contacts(
            fingers={name: (Press(*left), Press(*right)) for name, (left, right) in fingers.items()},
            knocks=knocks,
            supports=supports,
            depths=depths,
        )


def _dot(a: tuple[float, ...], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def overlaps(scene: BulletScene) -> dict[tuple[str, str], float]:
    """Return how deeply each pair of bodies overlaps now, as `SimScene.overlaps` does.

    Args:
        scene: The scene in Bullet.
    """
    bolted = {"table", *scene.fixtures}
    return {
        (a, b): max((-contact[8] for contact in scene.client.getContactPoints(i, j)), default=0.0)
        for (a, i), (b, j) in combinations(scene.bodies.items(), 2)
        if not {a, b} <= bolted
    }
