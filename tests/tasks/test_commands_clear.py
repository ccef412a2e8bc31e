"""No phase of the nine tasks commands the palm or the fingertips into the table, an object or a fixture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pybullet
import pytest

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import ControlStep
from dynaforge.geometry import Pose
from dynaforge.registration import ENV_NAMES
from dynaforge.sim import HandTarget
from dynaforge.sim.hand_target import PALM, TIP
from dynaforge.tasks import Mode, Phase, Task, get_task

EVERY = 5  # control steps
INSIDE = 0.001  # metres of overlap that count
# Half extents and centres in the end-effector frame, metres: the palm, and the tips of the fingers.
PALM_HALF, PALM_CENTRE = (0.03, 0.1, 0.01), (0.0, 0.0, -PALM - 0.01)
TIP_HALF = (0.009, 0.005, 0.004)
# The finger that presses a button is in it by the few millimetres that keep it moving; a hand that catches meets what
# flies toward it.
MEANT = {("alarmclock", "press"), ("lemon", "close")}


def corners(env: ResidualEnv, step: ControlStep, phase: Phase) -> Iterator[HandTarget]:
    """Yield what the projection leaves of the plan alone, and with residuals at the bounds of the translation."""
    assert step.planned is not None
    scale, executor, n = env.residual_scale, env.executor, env.residual_scale.size
    actions = [np.zeros(n)]
    if phase.gate:
        for signs in np.ndindex(3, 3, 2):
            action = np.zeros(n)
            moving = np.array((signs[0] - 1.0, signs[1] - 1.0, 2.0 * signs[2] - 1.0))
            active = np.flatnonzero(env.task.residual.scales[:3])
            action[: len(active)] = moving[active]
            actions.append(action)
    for action in actions:
        requested = step.planned.target.corrected(scale.physical(action, executor))
        yield requested.within_reach(env.world.local.robot, lowest=step.planned.lowest)


def depths(
    env: ResidualEnv, target: HandTarget, shapes: dict[str, int], *, width: float, touched: bool
) -> Iterator[tuple[str, str, float]]:
    """Yield part of the hand, body and depth for every overlap that the hand would have at a target.

    Fingers may touch the sides of what they grasp, so fingers and the manipulated object are left out; and so are the
    palm and that object once the robot has touched it, since it then moves with the hand, or was overturned by it.
    """
    bullet = env.world.scene._bullet
    held = env.task.manipulated
    parts = [("palm", PALM_CENTRE)]
    parts += [("finger", (0.0, side * (width / 2 + 0.006), TIP - 0.004)) for side in (-1.0, 1.0)]
    for part, centre in parts:
        pose = target.pose @ Pose(np.eye(3), np.array(centre))
        for name, body in bullet.bodies.items():
            if name == "robot" or (name == held and (part == "finger" or touched)):
                continue
            points = bullet.client.getClosestPoints(
                bodyA=-1,
                bodyB=body,
                distance=0.0,
                collisionShapeA=shapes[part],
                collisionShapePositionA=pose.position.tolist(),
                collisionShapeOrientationA=np.roll(pose.quat_wxyz, -1).tolist(),
            )
            yield part, name, max((-point[8] for point in points), default=0.0)


def violations(task: Task, *, seeds: range) -> dict[tuple[str, str, str, str], float]:
    """Return the deepest overlap by phase, residual ("plan" without one), part of the hand, and body."""
    env = ResidualEnv(task)
    found: dict[tuple[str, str, str, str], float] = {}
    count, touched = 0, False
    bullet = env.world.scene._bullet
    make = bullet.client.createCollisionShape
    shapes = {
        part: make(pybullet.GEOM_BOX, halfExtents=half) for part, half in (("palm", PALM_HALF), ("finger", TIP_HALF))
    }

    def look(step: ControlStep) -> None:
        nonlocal count, touched
        count += 1
        robot, held = bullet.bodies["robot"], bullet.bodies[env.task.manipulated]
        near = bool(bullet.client.getClosestPoints(robot, held, 0.005))  # or was in contact within the control step
        touched = (touched and step.before.time > 0.0) or near
        if count % EVERY or step.planned is None:
            return
        phase = env.task.phases[step.planned.phase]
        if (task.name, phase.name) in MEANT or phase is not env.executor.phase:
            return
        if phase.mode is Mode.GLOBAL and step.planned.sample is None:
            return
        for target in corners(env, step, phase):
            # Where the hand would be with respect to what is now, at the opening that it has now.
            for part, body, depth in depths(env, target, shapes, width=step.after.width, touched=touched):
                key = (phase.name, "bounds" if phase.gate else "plan", part, body)
                if depth > INSIDE and depth > found.get(key, 0.0):
                    found[key] = depth

    with env.world.listening(look):
        for seed in seeds:
            condition = env.task.conditions.draw(np.random.default_rng(seed), seed % 4, 8)
            env.reset(options={"condition": condition})
            done = False
            while not done:
                _, _, done, _, _ = env.step(np.zeros(env.action_space.shape or (), np.float32))
    env.close()
    return found


@pytest.mark.parametrize("name", ENV_NAMES)
def test_no_command_is_inside_a_body_or_the_table(name: str) -> None:
    assert violations(get_task(name), seeds=range(1)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", ENV_NAMES)
def test_no_command_of_many_episodes_is_inside_a_body_or_the_table(name: str) -> None:
    assert violations(get_task(name), seeds=range(16)) == {}


def test_without_its_least_height_a_phase_presses_the_palm_onto_the_can() -> None:
    can = get_task("can")
    pressing = replace(can, phases=tuple(replace(phase, lowest=None) for phase in can.phases))
    assert ("descend", "bounds", "palm", "can") in violations(pressing, seeds=range(1))
