"""Collision checks of the arm with itself, the table and fixtures, by coal through Pinocchio."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import coal
import numpy as np
import pinocchio as pin

from dynaforge.geometry import Array, Pose
from dynaforge.planning.kinematics import load_model
from dynaforge.sim.robot import RobotDescription

Shape = Literal["box", "cylinder", "sphere"]

N_SIZES = {"box": 3, "cylinder": 2, "sphere": 1}
LEVERS = np.array((1.0, 1.0, 1.0, 1.0, 0.4, 0.4, 0.2))
"""More than how far a joint moves the hand, in shares of what the first joints can (0.85 m per radian)."""
WORLD = 0  # Pinocchio's index of the joint to which everything fixed is attached


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """A fixed body that the arm must not touch.

    Attributes:
        name: Name in the answers of `CollisionModel.colliding_pair`.
        shape: One of "box", "cylinder" (axis z) and "sphere".
        size: Metres. Box: three full side lengths; cylinder: radius, length; sphere: radius.
        T_world_obstacle: Pose of the centre.

    Raises:
        ValueError: The shape is unknown, or the sizes are not positive or of the wrong number.
    """

    name: str
    shape: Shape
    size: tuple[float, ...]
    T_world_obstacle: Pose

    def __post_init__(self) -> None:
        if self.shape not in N_SIZES:
            raise ValueError(f"Obstacle {self.name!r} has shape {self.shape!r}; known are {', '.join(N_SIZES)}.")
        expected = N_SIZES[self.shape]
        if len(self.size) != expected or not all(0 < s < math.inf for s in self.size):
            raise ValueError(
                f"Obstacle {self.name!r} has size {self.size!r}; "
                f"a {self.shape} needs {expected} positive length(s) in metres."
            )


TABLE = Obstacle("table", "box", (1.8, 6.0, 0.1), Pose(np.eye(3), np.array((0.2, 0.0, -0.05))))
"""The table of every scene: its top is z = 0, and the robot's base stands on it."""


class CollisionModel:
    """Checks whether the arm, with open fingers, touches itself, the table or a fixture.

    Links are represented by the convex hulls of their collision meshes. Neighbouring links are not checked against each
    other, nor are bodies that cannot move apart, such as the base and the table. A grasped object is not part of the
    model.

    Args:
        robot: Geometry of the arm.
        fixtures: Fixed bodies other than the table.
        table: The table; None leaves it out.
        clearance: Distance below which bodies count as touching in checks with clearance, metres.

    Raises:
        ValueError: Two obstacles have the same name.
    """

    def __init__(
        self,
        robot: RobotDescription,
        *,
        fixtures: Sequence[Obstacle] = (),
        table: Obstacle | None = TABLE,
        clearance: float = 0.005,
    ) -> None:
        obstacles = (*((table,) if table else ()), *fixtures)
        names = [obstacle.name for obstacle in obstacles]
        if len(set(names)) < len(names):
            raise ValueError(f"Obstacles are named {names}; every name must be unique.")
        self._model, self._geometry = _with_obstacles(robot, obstacles)
        self._data = self._model.createData()
        self._touching = pin.GeometryData(self._geometry)
        self._near = pin.GeometryData(self._geometry)
        for request in self._near.collisionRequests:
            request.security_margin = clearance
        bodies = [body.name for body in self._geometry.geometryObjects]
        self._pairs = [(bodies[pair.first], bodies[pair.second]) for pair in self._geometry.collisionPairs]

    def in_collision(self, q: Array, *, clear: bool = False) -> bool:
        """Return whether the arm touches anything at joint positions q, radians, shape (7,).

        With `clear`, a distance below the clearance counts as touching.
        """
        results = self._near if clear else self._touching
        hit: bool = pin.computeCollisions(self._model, self._data, self._geometry, results, q, True)
        return hit

    def colliding_pair(self, q: Array) -> tuple[str, str] | None:
        """Return the names of two bodies that touch at q, or None; links are named as in the URDF."""
        # All pairs are checked: after an early stop, later results would be those of a previous call.
        if not pin.computeCollisions(self._model, self._data, self._geometry, self._touching, q, False):
            return None
        results = self._touching.collisionResults
        return next(pair for pair, result in zip(self._pairs, results, strict=True) if result.isCollision())

    def edge_free(self, q0: Array, q1: Array, *, resolution: float = 0.05, clear: bool = False) -> bool:
        """Return whether the straight joint-space edge from q0 to q1 is free, ends included.

        The ends are checked first, then the middle, then finer and finer, so that a blocked edge is found early.

        Args:
            q0: One end, radians, shape (7,).
            q1: The other end, radians, shape (7,).
            resolution: Largest change of joints 1 to 4 between neighbouring checks, radians; those of the wrist, which
                move the hand less, may change by `1 / LEVERS` of it.
            clear: Whether the clearance must be kept along the whole edge.
        """
        n = max(1, math.ceil(float((LEVERS * np.abs(q1 - q0)).max()) / resolution))
        fractions = bisection_order(n)
        path = q0 + fractions[:, None] * (q1 - q0)
        return not any(self.in_collision(q, clear=clear) for q in path)


@lru_cache(maxsize=256)
def bisection_order(n: int) -> Array:
    """Return k / n for k = 0..n, the ends first and then the middles of ever smaller gaps, shape (n + 1,)."""
    order = [0, n]
    stride = 1 << max(n - 1, 1).bit_length()
    seen = set(order)
    while stride >= 1:
        middles = [k for k in range(stride, n, stride) if k not in seen]
        order += middles
        seen.update(middles)
        stride //= 2
    return np.array(order) / n


@lru_cache(maxsize=4)
def _arm_hulls(urdf: Path, arm_joints: tuple[str, ...], width_max: float) -> tuple[Any, Any]:
    """Return the Pinocchio model and its collision geometry as convex hulls, with the pairs of links to check."""
    model, meshes = load_model(urdf, arm_joints, width_max)
    geometry = meshes.copy()
    for body in geometry.geometryObjects:
        body.name = body.name.removesuffix("_0")  # Pinocchio numbers the shapes of a link; here each link has one
        body.geometry.buildConvexRepresentation(False)
        body.geometry = body.geometry.convex
    bodies = geometry.geometryObjects
    for i in range(len(bodies)):
        for j in range(i):
            if abs(bodies[i].parentJoint - bodies[j].parentJoint) > 1:
                geometry.addCollisionPair(pin.CollisionPair(j, i))
    return model, geometry


def _with_obstacles(robot: RobotDescription, obstacles: Sequence[Obstacle]) -> tuple[Any, Any]:
    """Add obstacles to a copy of the arm's hulls, each paired with every moving link."""
    model, arm = _arm_hulls(robot.urdf, robot.arm_joints, robot.width_max)
    geometry = arm.copy()
    links = [i for i, body in enumerate(arm.geometryObjects) if body.parentJoint != WORLD]
    for obstacle in obstacles:
        pose = obstacle.T_world_obstacle
        index = geometry.addGeometryObject(
            pin.GeometryObject(obstacle.name, WORLD, pin.SE3(pose.rotation, pose.position), _coal_shape(obstacle))
        )
        for link in reversed(links):  # the hand first: it touches most often, and the first hit ends the check
            geometry.addCollisionPair(pin.CollisionPair(link, index))
    return model, geometry


def _coal_shape(obstacle: Obstacle) -> Any:
    if obstacle.shape == "box":
        return coal.Box(*obstacle.size)
    if obstacle.shape == "cylinder":
        return coal.Cylinder(*obstacle.size)
    return coal.Sphere(*obstacle.size)
