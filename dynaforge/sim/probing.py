"""Looking inside a control step, and pushing the robot: what benchmarks and tests do to a scene, and no task can."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from dynaforge.geometry import Array
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.scene import SimScene


def _nothing() -> None: ...


@contextlib.contextmanager
def at_every_substep(
    scene: SimScene, *, before: Callable[[], None] = _nothing, after: Callable[[], None] = _nothing
) -> Iterator[None]:
    """Call functions before and after every substep that a scene makes in the block.

    Args:
        scene: The scene.
        before: Called before a substep; what it pushes is pushed during that substep.
        after: Called after a substep.
    """
    step = scene._step_physics

    def probed_step() -> None:
        before()
        step()
        after()

    scene._step_physics = probed_step
    try:
        yield
    finally:
        scene._step_physics = step


def push_fingers(scene: SimScene, forces: tuple[float, float]) -> None:
    """Push the left and the right finger outward for one substep, newtons; negative is inward."""
    client, robot = scene._bullet.client, scene._bullet.robot
    outward = scene.observe().ee.rotation[:, 1]
    for finger, force, axis in zip(robot.fingers, forces, (outward, -outward), strict=True):
        at = client.getLinkState(robot.body, finger)[0]
        client.applyExternalForce(robot.body, finger, (force * axis).tolist(), at, p.WORLD_FRAME)


def push_hand(scene: SimScene, force: Array) -> None:
    """Push the hand at the origin of its frame for one substep.

    Args:
        scene: The scene.
        force: World axes, newtons, shape (3,).
    """
    client, robot = scene._bullet.client, scene._bullet.robot
    at = client.getLinkState(robot.body, robot.ee)[4]
    client.applyExternalForce(robot.body, robot.ee, force.tolist(), at, p.WORLD_FRAME)


@contextlib.contextmanager
def blind(scene: SimScene) -> Iterator[None]:
    """Let the scene watch no forces in the block: its loads stay 0 and its reflex does not act."""
    watch, contacts = scene._watch, scene._contacts
    watch.see = lambda contacts: None  # type: ignore[method-assign]
    contacts.of_robot = tuple  # type: ignore[method-assign]
    try:
        yield
    finally:
        del watch.see, contacts.of_robot
