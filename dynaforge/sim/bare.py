"""The bare simulator: motor commands replayed without the rest of the stack, to measure what the rest costs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from dynaforge.geometry import Array
from dynaforge.sim.arm_motors import ArmCommand
from dynaforge.sim.condition import Condition
from dynaforge.sim.hand import HandCommand
from dynaforge.sim.scene import SimScene
from dynaforge.sim.state import SceneState


@dataclass(frozen=True, slots=True)
class MotorCommands:
    """The commands to all motors in one control step, computed beforehand.

    Attributes:
        arm: Commands to the arm's motors, one per substep.
        hand: What `Hand.command` is told in the course of it.
        fixtures: Motor speeds of each fixture, rad/s or m/s.
        opens_gate: Whether the first gate opens before it, where `World` renews contacts.
    """

    arm: list[ArmCommand]
    hand: HandCommand
    fixtures: list[list[float]]
    opens_gate: bool


def motor_commands(
    scene: SimScene, condition: Condition, references: Sequence[tuple[Array, float]], *, first_gate: int | None
) -> list[MotorCommands]:
    """Simulate an episode and return the commands to its motors.

    Args:
        scene: The scene to simulate it in.
        condition: The condition of the episode.
        references: Joint reference (rad, shape (7,)) and opening (m) of each control step, as `SimScene.step` takes
            them.
        first_gate: Index of the first control step whose gate was open; None where there was none.

    Returns:
        The commands of each control step.
    """
    spec, fixtures = scene.spec, scene._bullet.fixtures.values()
    state, commands = scene.reset(condition), []
    for step, (q, width) in enumerate(references):
        if step == first_gate:
            scene.renew_contacts()
        due = [fixture.due(state.time + spec.control_dt, spec.control_dt) for fixture in fixtures]
        state = scene.step(q, width)
        commands.append(MotorCommands(scene._arm.last, scene._hand.last, due, step == first_gate))
    return commands


def replay_bare(scene: SimScene, condition: Condition, commands: Sequence[MotorCommands]) -> tuple[float, SceneState]:
    """Replay the motor commands of an episode, and nothing else.

    The hand is commanded where its command changes, fixtures once per control step.

    Args:
        scene: The scene to simulate it in.
        condition: The condition of the episode.
        commands: What `motor_commands` returned for it.

    Returns:
        CPU seconds without the reset and the renewal of contacts at the first gate, and the state at the end, whose
        time is not updated.
    """
    scene.reset(condition)
    # The scene's own bound calls: any other way to call Bullet is slower, and would make the whole stack look better.
    run_arm, step_physics, hand = scene._arm.run, scene._step_physics, scene._hand
    fixtures = tuple(scene._bullet.fixtures.values())
    due_substep, told = hand.state.due, hand.last
    begin = time.process_time()
    for step in commands:
        if step.opens_gate:
            paused = time.process_time()
            scene.renew_contacts()
            begin += time.process_time() - paused
        for fixture, due in zip(fixtures, step.fixtures, strict=True):
            fixture.command(due)
        for substep, command in enumerate(step.arm):
            if substep == due_substep and step.hand != told:
                hand.command(step.hand)
                told = step.hand
            run_arm(command)
            step_physics()
    return time.process_time() - begin, scene.observe()
