"""What the state machine of DynamicVLA's collector is told of a task, and what it sees in a scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dynaforge.geometry import Array, Pose, rotation_z
from dynaforge.sim import BodyState, SceneState
from dynaforge.sim.hand_target import under_palm
from dynaforge.sim.robot import HAND_WIDTH
from dynaforge.tasks import Task
from dynaforge.tasks.targets import DOWN_ALONG_Y

Size = tuple[float, float, float]
SIZES: Mapping[str, Size] = {
    "can": (0.066, 0.066, 0.120),
    "bottle": (0.066, 0.066, 0.165),
    "toycar": (0.104, 0.056, 0.055),
    "peach": (0.062, 0.062, 0.062),
    "block": (0.045, 0.045, 0.045),
}
"""The tasks for which it has the skill: the box around the object, along the object's own axes, metres."""
CONTAINERS: Mapping[str, Size] = {"bowl": (0.104, 0.104, 0.028), "pad": (0.090, 0.090, 0.008)}
"""The box around what it places objects in, metres."""
BALLS = ("peach",)
"""The tasks whose object has no sides."""

LEAD = 0.23  # seconds of constant velocity by which a grasp is predicted
OFFSET = np.array((0.0, 0.0, 0.10))  # metres
REACH = 0.75  # metres between base and grasp
LOST = 0.10  # metres between hand and object
SLOW = 0.05  # m/s: below, a hand that is above something is within BESIDE of it in x and y; otherwise within OVER in z
BESIDE, OVER = 0.01, 0.11  # metres
STILL = 0.10  # m/s: below, the hand goes by the sides of the object, otherwise by its velocity
TALL, SUNK, LOWEST = 0.016, 0.008, 0.008  # metres: objects above TALL are grasped SUNK below the middle; least height
MARGIN = 0.02  # metres around a container in which things still count as over it, or in it


@dataclass(frozen=True, slots=True, kw_only=True)
class Skill:
    """What the method is told of a task.

    Attributes:
        object: Name of what it grasps.
        size: The box around the object, along its own axes, metres.
        ball: Whether the object has no sides.
        container: Name of what it places the object in; None where it only lifts.
        container_size: The box around the container, along its own axes, metres.
        closed: Opening that is commanded to close the hand, metres.
    """

    object: str
    size: Size
    ball: bool = False
    container: str | None = None
    container_size: Size = (0.0, 0.0, 0.0)
    closed: float = 0.0


def skill_for(task: Task) -> Skill:
    """Return what the method is told of a task.

    Raises:
        ValueError: It lacks the skill.
    """
    if task.name not in SIZES:
        raise ValueError(f"state_machine cannot do task {task.name!r}; its supported tasks are {', '.join(SIZES)}.")
    closed = min(phase.width for phase in task.phases)
    skill = Skill(object=task.manipulated, size=SIZES[task.name], ball=task.name in BALLS, closed=closed)
    container = next((name for name in task.scene.tracked if name in CONTAINERS), None)
    return skill if container is None else replace(skill, container=container, container_size=CONTAINERS[container])


class Sight:
    """A scene in the terms of the transition table.

    Args:
        skill: What the method is told of the task.
        scene: The scene as sensed.

    Attributes:
        hand: Pose of the hand, `T_world_ee`.
        object: The object.
        grasp: The pose in which the hand grasps the object where it is going, `T_world_ee`.
    """

    def __init__(self, skill: Skill, scene: SceneState) -> None:
        self.skill, self.hand, self.object = skill, scene.ee, scene.objects[skill.object]
        self._container = None if skill.container is None else scene.objects[skill.container]
        self._height = float(np.linalg.norm(skill.size * self.object.pose.rotation[2]))
        x, y, z = (self.object.pose.position + LEAD * self.object.velocity).tolist()
        z += max(-SUNK if self._height > TALL else 0.0, under_palm(self._height / 2))
        rotation = rotation_z(grasp_yaw(self.object, skill)) @ DOWN_ALONG_Y
        self.grasp = Pose(rotation, np.array((x, y, max(z, LOWEST))))

    @property
    def place(self) -> Pose:
        """The pose in which the hand opens over the container, `T_world_ee`."""
        return raised(Pose(DOWN_ALONG_Y, self.container.pose.position))

    @property
    def container(self) -> BodyState:
        """The container."""
        assert self._container is not None, "only a skill with a container asks for it"
        return self._container

    @property
    def yaw_error(self) -> float:
        """The angle about the vertical between the hand and its grasp, radians."""
        (x, y, _), (u, v, _) = self.hand.rotation[:, 1].tolist(), self.grasp.rotation[:, 1].tolist()
        return abs(math.atan2(x * v - y * u, x * u + y * v))

    @property
    def reachable(self) -> bool:
        """Whether the grasp is near enough to the base."""
        return bool(np.linalg.norm(self.grasp.position) < REACH)

    @property
    def above_object(self) -> bool:
        """Whether the hand is above the object where it is now."""
        return is_above(self.hand, self.object.pose.position, self.object.velocity)

    @property
    def above_container(self) -> bool:
        """Whether the hand is above the place where it opens, and not only on its way there."""
        place = self.place.position
        arrived = math.dist(self.hand.position[:2], place[:2]) <= MARGIN
        return arrived and is_above(self.hand, place, self.container.velocity)

    @property
    def lost(self) -> bool:
        """Whether the object is not in the hand."""
        return math.dist(self.hand.position, self.object.pose.position) > LOST

    @property
    def placed(self) -> bool:
        """Whether the object's foot is in the box around the container, or hardly outside."""
        x, y, z = self.container.pose.inverse().apply(self.object.pose.position).tolist()
        foot = np.abs((x, y, z - self._height / 2))
        return bool((foot <= np.divide(self.skill.container_size, 2) + MARGIN).all())


def raised(pose: Pose, share: float = 1.0) -> Pose:
    """Return a pose moved up by the offset, or by a share of it."""
    return Pose(pose.rotation, pose.position + share * OFFSET)


def is_above(hand: Pose, place: Array, velocity: Array) -> bool:
    """Return whether the hand counts as above a place.

    Args:
        hand: Pose of the hand, `T_world_ee`.
        place: The place, metres, shape (3,).
        velocity: How fast it moves, m/s, shape (3,).
    """
    x, y, z = np.abs(hand.position - place).tolist()
    return bool(z <= OVER) if np.linalg.norm(velocity) >= SLOW else bool(x <= BESIDE and y <= BESIDE)


def grasp_yaw(body: BodyState, skill: Skill) -> float:
    """Return how far the line in which the fingers open is turned from the y axis, radians, a quarter turn at most.

    It is the velocity of an object at 0.10 m/s or more, and the shorter side of a slower one; also of a faster one that
    moves along a side which is longer than the hand opens.

    Args:
        body: The object.
        skill: Tells its size.
    """
    x, y, _ = body.velocity.tolist()
    speed = float(np.linalg.norm(body.velocity))
    if skill.ball:
        x, y = (0.0, 1.0) if speed < STILL else (x, y)
    elif speed < STILL or _moves_along_long_side(body, skill.size):
        x, y = shorter_side(body.pose.rotation, skill.size).tolist()
    angle = math.atan2(-x, y)
    return angle - math.copysign(math.pi, angle) if abs(angle) > math.pi / 2 else angle


def shorter_side(rotation: Array, size: Size) -> Array:
    """Return the horizontal direction of the shorter side of a box as seen from above, shape (2,).

    Args:
        rotation: Rotation of the box, shape (3, 3).
        size: Its sides, metres.
    """
    sides = rotation.T * np.reshape(size, (3, 1))  # a side in each row, in world coordinates
    seen = np.delete(sides, np.abs(sides[:, 2]).argmax(), axis=0)[:, :2]
    first, second = np.linalg.norm(seen, axis=1)
    direction: Array = seen[0] if first <= 1.05 * second else seen[1]
    return direction


def _moves_along_long_side(body: BodyState, size: Size) -> bool:
    longest = int(np.argmax(size))
    along = abs(float(body.pose.rotation[:, longest] @ body.velocity))
    return size[longest] > HAND_WIDTH and along > math.sqrt(0.5) * float(np.linalg.norm(body.velocity))
