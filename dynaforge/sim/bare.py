"""The bare simulator: motor commands replayed with nothing around them, to measure what everything else costs."""

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
    """All that is asked of the motors in one control step, computed beforehand.

    Attributes:
        path: Joint targets of the arm in each substep, radians.
        velocity: Joint velocities fed forward with them, rad/s.
        width: Opening of the hand, metres.
        fixtures: Speeds of the motors of each fixture, rad/s or m/s.
    """

    path: list[list[float]]
    velocity: list[float]
    width: float
    fixtures: list[list[float]]


def motor_commands(
    scene: SimScene, condition: Condition, references: Sequence[tuple[Array, float]]
) -> list[MotorCommands]:
    """Simulate an episode and note what its motors are asked for.

    Args:
        scene: Where.
        condition: What fixes the episode.
        references: Joint reference (rad, shape (7,)) and opening (m) of each control step, as `SimScene.step` takes
            them.
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
    """Replay an episode's motor commands with nothing around them.

    The opening is commanded where it changes, and fixtures once a control step.

    Args:
        scene: Where.
        condition: What fixes the episode.
        commands: What `motor_commands` noted of it.

    Returns:
        CPU seconds, without the reset, and the state at the end; its time is not kept.
    """
    scene.reset(condition)
    # The scene's own bound calls: any other way of calling Bullet is slower and would flatter the ratio.
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
