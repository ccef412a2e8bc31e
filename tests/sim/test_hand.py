"""The hand holds its width, closes as one rack and pinion, is no faster than its limit, and answers late."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dynaforge.benchmarks.episodes import bench_conditions, run_planner_only
from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.world import World
from dynaforge.geometry import Array
from dynaforge.sim import Condition, SimScene
from dynaforge.sim.bullet import HAND_STIFFNESS
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.probing import push_fingers
from dynaforge.tasks import TASK_NAMES, get_task

TASK = get_task("can")
CONDITION = TASK.conditions.draw(np.random.default_rng(5), 4, 8)


def late(delay: float) -> Condition:
    """The condition with a dead time of the hand, seconds."""
    return replace(CONDITION, hidden={"hand_delay": delay})


def at_every_substep(scene: SimScene, monkeypatch: pytest.MonkeyPatch, push: Callable[[], None]) -> list[Array]:
    """Call `push` before every substep from now on; return a list that the finger positions after it are added to."""
    step, positions = scene._step_physics, list[Array]()

    def pushed_step() -> None:
        push()
        step()
        positions.append(scene.fingers()[0])

    monkeypatch.setattr(scene, "_step_physics", pushed_step)
    return positions


@pytest.mark.parametrize("forces", [(70.0, 0.0), (0.0, 70.0), (70.0, 70.0), (140.0, 140.0), (-70.0, -70.0)])
def test_no_push_moves_the_fingers(
    scene: SimScene, monkeypatch: pytest.MonkeyPatch, forces: tuple[float, float]
) -> None:
    scene.reset(CONDITION)
    for _ in range(20):
        scene.step(scene.robot.q_ready, 0.04)
    before, _ = scene.fingers()
    np.testing.assert_allclose(before, 0.02, atol=2e-4)
    positions = at_every_substep(scene, monkeypatch, lambda: push_fingers(scene, forces))
    for _ in range(10):
        scene.step(scene.robot.q_ready, 0.04)
    assert len(positions) == 10 * scene.spec.substeps
    assert np.abs(np.array(positions) - before).max() < 1e-3
    assert np.ptp(positions, axis=1).max() < 1e-3


def close_on_can(scene: SimScene, monkeypatch: pytest.MonkeyPatch, *, mass: float) -> tuple[list[Array], list[float]]:
    """Close the hand on the can, which stands weightless between the fingers and 6 mm nearer to the left one.

    Args:
        scene: The scene.
        monkeypatch: Undoes what is done to the scene.
        mass: The can's mass, kg.

    Returns:
        The finger positions (m) at every substep, and the force (N) of each finger on the can at the end.
    """
    ee = scene.reset(CONDITION).ee
    client, robot, can = scene._bullet.client, scene._bullet.robot, scene._bullet.bodies["can"]
    position = ee.position + ee.rotation @ (0.0, 0.006, 0.035)  # clear of the palm
    client.changeDynamics(can, -1, mass=mass)
    client.resetBasePositionAndOrientation(can, position.tolist(), (0, 0, 0, 1))
    client.resetBaseVelocity(can, (0, 0, 0), (0, 0, 0))

    def carry() -> None:
        at = client.getBasePositionAndOrientation(can)[0]
        client.applyExternalForce(can, -1, (0, 0, 9.81 * mass), at, p.WORLD_FRAME)

    positions = at_every_substep(scene, monkeypatch, carry)
    for _ in range(25):
        scene.step(scene.robot.q_ready, 0.0)
    return positions, [sum(c[9] for c in client.getContactPoints(robot.body, can, finger)) for finger in robot.fingers]


def test_a_finger_that_meets_an_object_first_pushes_it_and_both_grip_with_the_closing_force(
    scene: SimScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    positions, forces = close_on_can(scene, monkeypatch, mass=1.0)
    assert np.ptp(positions, axis=1).max() < 1e-3
    assert positions[-1].sum() == pytest.approx(0.066, abs=3e-3)
    assert forces == pytest.approx([scene.robot.grip_force] * 2, rel=0.1)


def test_pads_yield_by_force_over_stiffness(scene: SimScene, monkeypatch: pytest.MonkeyPatch) -> None:
    close_on_can(scene, monkeypatch, mass=1.0)
    bullet = scene._bullet
    for finger in bullet.robot.fingers:
        contacts = bullet.client.getContactPoints(bullet.robot.body, bullet.bodies["can"], finger)
        depth = np.mean([-c[8] for c in contacts])
        assert depth == pytest.approx(np.mean([c[9] for c in contacts]) / HAND_STIFFNESS, rel=0.3)


def test_fingers_stay_symmetric_when_one_of_them_is_stopped(scene: SimScene, monkeypatch: pytest.MonkeyPatch) -> None:
    positions, forces = close_on_can(scene, monkeypatch, mass=1000.0)
    assert max(forces) > 30.0
    assert np.ptp(positions, axis=1).max() < 1e-3


def test_a_hand_that_grips_is_not_pushed_open(scene: SimScene, monkeypatch: pytest.MonkeyPatch) -> None:
    positions, _ = close_on_can(scene, monkeypatch, mass=1.0)
    before = len(positions)
    at_every_substep(scene, monkeypatch, lambda: push_fingers(scene, (140.0, 140.0)))
    for _ in range(10):
        scene.step(scene.robot.q_ready, 0.0)
    assert np.max(np.array(positions[before:]) - positions[before - 1]) < 1e-3


@pytest.mark.parametrize(("width", "push"), [(0.0, 200.0), (0.08, -200.0)])
def test_a_moving_hand_is_not_pushed_back(
    scene: SimScene, monkeypatch: pytest.MonkeyPatch, width: float, push: float
) -> None:
    """It may lose what it has moved since the command before, and for one substep what a sudden force moves it."""
    scene.reset(CONDITION)
    for wanted, steps in ((0.08 - width, 35), (width, 15)):
        for _ in range(steps):
            scene.step(scene.robot.q_ready, wanted)
    before, _ = scene.fingers()
    assert 0.01 < before[0] < 0.03
    positions = at_every_substep(scene, monkeypatch, lambda: push_fingers(scene, (push, push)))
    for _ in range(10):
        scene.step(scene.robot.q_ready, width)
    back = np.sign(push) * (np.array(positions) - before)
    assert back[8:].max() < scene.robot.finger_speed_max * scene.spec.control_dt + 1e-3


@pytest.mark.parametrize("substeps", [0, 5, 8, 24, 30])
def test_the_hand_answers_after_its_dead_time_to_the_substep(
    scene: SimScene, monkeypatch: pytest.MonkeyPatch, substeps: int
) -> None:
    scene.reset(late(substeps * scene.spec.physics_dt))
    positions = at_every_substep(scene, monkeypatch, lambda: None)
    for _ in range(6):
        scene.step(scene.robot.q_ready, 0.0)
    moved = np.array(positions)[:, 0] < scene.robot.width_max / 2 - 1e-5
    assert not moved[:substeps].any()
    assert moved[substeps:].all()


def test_a_command_of_one_control_step_arrives_late_and_whole(scene: SimScene, monkeypatch: pytest.MonkeyPatch) -> None:
    scene.reset(late(0.15))
    positions = at_every_substep(scene, monkeypatch, lambda: None)
    for k in range(16):
        scene.step(scene.robot.q_ready, 0.0 if k == 0 else 0.08)
    assert np.min(positions) == pytest.approx(0.04 - 0.05 / 30, abs=2e-5)
    assert positions[-1][0] == pytest.approx(0.04, abs=1e-5)


def test_without_a_dead_time_of_its_own_a_condition_gets_the_usual_one(scene: SimScene) -> None:
    def trace(condition: Condition) -> list[float]:
        scene.reset(condition)
        return [scene.step(scene.robot.q_ready, 0.0).width for _ in range(10)]

    assert trace(replace(CONDITION, hidden={})) == trace(late(0.1)) != trace(late(0.05))


def test_the_hand_forgets_the_episode_before(scene: SimScene) -> None:
    def trace() -> list[bytes]:
        scene.reset(late(0.13))
        return [
            np.concatenate((scene.step(scene.robot.q_ready, 0.03).q, *scene.fingers())).tobytes() for _ in range(20)
        ]

    first = trace()
    scene.reset(late(0.05))
    for _ in range(25):
        scene.step(scene.robot.q_ready, 0.01)
    assert trace() == first


def test_what_the_hand_remembers_can_be_restored(scene: SimScene) -> None:
    scene.reset(late(0.13))
    for _ in range(10):
        scene.step(scene.robot.q_ready, 0.03)
    kept = scene._hand.state
    for _ in range(5):
        scene.step(scene.robot.q_ready, 0.08)
    assert scene._hand.state != kept
    scene._hand.restore(kept)
    assert scene._hand.state == kept


def asymmetry(name: str, n: int) -> float:
    """The greatest difference of the finger positions in n planner-only episodes of a task, metres."""
    task = get_task(name)
    world = World(task)
    executor = PhaseExecutor(task, world.planner, control_dt=task.scene.control_dt)
    step, most = world.scene._step_physics, 0.0

    def watched_step() -> None:
        nonlocal most
        step()
        most = max(most, float(np.ptp(world.scene.fingers()[0])))

    world.scene._step_physics = watched_step
    for condition in bench_conditions(task, n):
        run_planner_only(world, executor, condition)
    world.close()
    return most


def test_fingers_stay_symmetric_in_an_episode() -> None:
    assert asymmetry("can", 1) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", TASK_NAMES)
def test_fingers_stay_symmetric_in_the_episodes_of_every_task(name: str) -> None:
    assert asymmetry(name, 6) < 1e-3
