"""The bare simulator: motor commands replayed without the rest of the stack, to measure what the rest costs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaforge.geometry import Array
from dynaforge.sim.condition import Condition
from dynaforge.sim.scene import SimScene
from dynaforge.sim.state import SceneState


@dataclass(frozen=True, slots=True)
class MotorCommands:
    """The commands to all motors in one control step, computed beforehand.

    Attributes:
        path: Joint targets of the arm at each substep, radians, shape (substeps, 7).
        velocity: Joint velocities fed forward with them, rad/s, shape (7,).
        width: Opening of the hand, metres.
        fixtures: Motor speeds of each fixture, rad/s or m/s.
    """

    path: list[list[float]]
    velocity: list[float]
    width: float
    fixtures: list[list[float]]


def motor_commands(
    scene: SimScene, condition: Condition, references: Sequence[tuple[Array, float]]
) -> list[MotorCommands]:
    """Simulate an episode and return the commands to its motors.

    Args:
        scene: The scene to simulate it in.
        condition: The condition of the episode.
        references: Joint reference (rad, shape (7,)) and opening (m) of each control step, as `SimScene.step` takes
            them.

    Returns:
        The commands of each control step.
    """
    spec, fixtures = scene.spec, scene._bullet.fixtures.values()
    shares = np.arange(1, spec.substeps + 1)[:, None] / spec.substeps
    state, start, commands = scene.reset(condition), scene.robot.q_ready, []
    for q, width in references:
        path, velocity = (start + shares * (q - start)).tolist(), ((q - start) / spec.control_dt).tolist()
        due = [fixture.due(state.time + spec.control_dt, spec.control_dt) for fixture in fixtures]
        commands.append(MotorCommands(path, velocity, width, due))
        state, start = scene.step(q, width), q
    return commands


def replay_bare(scene: SimScene, condition: Condition, commands: Sequence[MotorCommands]) -> tuple[float, SceneState]:
    """Replay the motor commands of an episode, and nothing else.

    The opening is commanded where it changes, and fixtures once per control step.

    Args:
        scene: The scene to simulate it in.
        condition: The condition of the episode.
        commands: What `motor_commands` returned for it.

    Returns:
        CPU seconds without the reset, and the state at the end, whose time is not updated.
    """
    scene.reset(condition)
    # The scene's own bound calls: any other way to call Bullet is slower, and would make the whole stack look better.
    command_arm, step_physics, finger_motors = scene._command_arm, scene._step_physics, scene._finger_motors
    fixtures = tuple(scene._bullet.fixtures.values())
    commanded = None
    begin = time.process_time()
    for step in commands:
        if step.width != commanded:
            commanded = step.width
            for command in finger_motors:
                command(targetPosition=step.width / 2)
        for fixture, due in zip(fixtures, step.fixtures, strict=True):
            fixture.command(due)
        velocity = step.velocity
        for q in step.path:
            command_arm(targetPositions=q, targetVelocities=velocity)
            step_physics()
    return time.process_time() - begin, scene.observe()
