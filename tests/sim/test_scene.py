from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynaforge.sim import BodySpec, Condition, SceneState, SimScene
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import get_task

TASK = get_task("can")
CONDITION = TASK.conditions.draw(np.random.default_rng(5), 4, 8)


def bits(state: SceneState) -> bytes:
    body = state.objects["can"]
    arrays = (state.q, state.dq, state.ee.position, state.ee.rotation, body.pose.position, body.pose.rotation)
    return b"".join(array.tobytes() for array in (*arrays, body.velocity, body.angular_velocity))


def mass_and_inertia(scene: SimScene) -> tuple[float, tuple[float, ...]]:
    bullet = scene._bullet
    mass, _, inertia = bullet.client.getDynamicsInfo(bullet.bodies["can"], -1)[:3]
    return mass, inertia


def test_reset_is_the_world_at_time_zero(scene: SimScene) -> None:
    state = scene.reset(CONDITION)
    launch = TASK.scene.launch(CONDITION)["can"]
    body = state.objects["can"]
    assert state.time == 0.0
    np.testing.assert_array_equal(state.q, scene.robot.q_ready)
    np.testing.assert_array_equal(state.dq, np.zeros(7))
    assert state.width == pytest.approx(scene.robot.width_max, abs=1e-9)
    np.testing.assert_allclose(body.pose.position, launch.pose.position, atol=1e-12)
    np.testing.assert_allclose(body.pose.rotation, launch.pose.rotation, atol=1e-12)
    np.testing.assert_allclose(body.velocity, launch.velocity, atol=1e-12)
    np.testing.assert_allclose(body.angular_velocity, launch.angular_velocity, atol=1e-12)


def test_the_mass_of_the_condition_reaches_physics_and_the_inertia_scales_with_it(scene: SimScene) -> None:
    scene.reset(CONDITION)
    mass, inertia = mass_and_inertia(scene)
    assert mass == pytest.approx(CONDITION.values["mass"])
    np.testing.assert_allclose(inertia, np.array((0.000295, 0.000295, 0.000109)) / 0.2 * mass)


def test_reset_forgets_contacts_velocities_and_motor_targets(scene: SimScene) -> None:
    still = scene.robot.q_ready

    def trace() -> list[bytes]:
        return [bits(scene.reset(CONDITION)), *(bits(scene.step(still, 0.08)) for _ in range(15))]

    first = trace()
    press = still + np.array((0.3, 0.6, 0.0, -0.2, 0.0, 0.0, 0.0))  # the hand goes down onto the table
    for _ in range(25):
        scene.step(press, 0.0)
    assert trace() == first


def test_a_reset_takes_milliseconds(scene: SimScene) -> None:
    """A loose bound for busy machines; `dynaforge bench` measures the figure."""
    durations = []
    for _ in range(50):
        start = time.perf_counter()
        scene.reset(CONDITION)
        durations.append(time.perf_counter() - start)
    assert np.median(durations) <= 0.005


def test_no_finger_is_faster_than_the_hand_in_any_substep() -> None:
    scene = SimScene(TASK.scene)
    positions: list[list[float]] = []
    speeds: list[float] = []
    step = scene._step_physics

    def measured_step() -> None:
        step()
        position, speed = scene.fingers()
        positions.append(position.tolist())
        speeds.extend(np.abs(speed).tolist())

    scene._step_physics = measured_step
    scene.reset(CONDITION)
    positions.clear()
    for width in [0.0] * 30 + [0.08] * 30:
        scene.step(scene.robot.q_ready, width)
    travelled = np.array(positions)
    closed = travelled[30 * scene.spec.substeps - 1]
    np.testing.assert_allclose(closed, 0.0, atol=5e-4)
    np.testing.assert_allclose(travelled[-1], 0.04, atol=5e-4)
    measured = np.abs(np.diff(travelled, axis=0)) / scene.spec.physics_dt
    assert 0.045 < measured.max() <= 0.05
    assert max(speeds) <= 0.05
    assert np.abs(travelled[:, 0] - travelled[:, 1]).max() < 1e-3, "the gear keeps the fingers together"
    scene.close()


def test_a_closing_hand_needs_the_time_that_its_speed_limit_gives(scene: SimScene) -> None:
    """80 mm at 100 mm/s after a dead time of 0.1 s: 0.9 s, 27 control steps."""
    state = scene.reset(replace(CONDITION, hidden={}))
    steps = 0
    while state.width > 0.001:
        state = scene.step(scene.robot.q_ready, 0.0)
        steps += 1
    assert 27 <= steps <= 31


@pytest.mark.parametrize("stratum", range(0, 8, 2))
def test_a_free_body_never_gains_speed_or_energy(scene: SimScene, stratum: int) -> None:
    condition = TASK.conditions.draw(np.random.default_rng(stratum), stratum, 8)
    state = scene.reset(condition)
    mass, inertia = mass_and_inertia(scene)

    def energy(state: SceneState) -> float:
        body = state.objects["can"]
        spin = body.pose.rotation.T @ body.angular_velocity
        kinetic = mass * (body.velocity @ body.velocity) + np.array(inertia) @ (spin * spin)
        return float(kinetic / 2 + mass * 9.81 * body.pose.position[2])

    speeds, energies = [condition.difficulty], [energy(state)]
    for _ in range(45):
        state = scene.step(scene.robot.q_ready, 0.08)
        speeds.append(float(np.linalg.norm(state.objects["can"].velocity)))
        energies.append(energy(state))
    assert state.on_table["can"]
    assert max(np.diff(speeds)) <= 1e-6
    assert max(np.diff(energies)) <= 1e-6
    assert condition.difficulty - speeds[-1] < 0.1, "a rolling can loses little speed in 1.5 s"


def test_motion_between_control_steps_agrees_with_the_velocity(scene: SimScene) -> None:
    before = scene.reset(CONDITION)
    for _ in range(30):
        after = scene.step(scene.robot.q_ready, 0.08)
        a, b = before.objects["can"], after.objects["can"]
        mean = (a.velocity + b.velocity) / 2 * scene.spec.control_dt
        np.testing.assert_allclose(b.pose.position - a.pose.position, mean, atol=1e-3)
        before = after


def test_the_arm_follows_a_reference_inside_its_limits(scene: SimScene) -> None:
    scene.reset(CONDITION)
    swing = np.array((1.0, 0.0, 0.0, 0.5, 0.0, -0.5, 1.0))
    for k in range(1, 31):
        reference = scene.robot.q_ready + swing * (1 - np.cos(np.pi * k / 30)) / 4
        state = scene.step(reference, 0.08)
        assert (np.abs(state.dq) <= scene.robot.dq_max).all()
    assert np.abs(state.q - reference).max() < 0.02


def test_a_joint_half_again_faster_than_its_limit_stops_the_robot(scene: SimScene) -> None:
    robot, dt = scene.robot, scene.spec.control_dt
    for share, stops in ((1.2, False), (2.0, True)):
        q = scene.reset(CONDITION).q.copy()
        states = []
        for k in range(1, 16):  # the wrist, which takes 0.4 s to get to its speed
            q[6] -= share * robot.dq_max[6] * dt * min(1.0, k / 12)
            states.append(scene.step(q.copy(), 0.08))
        assert any(state.stopped for state in states) is stops
        assert all(state.stopped == (abs(state.dq[6]) > 1.5 * robot.dq_max[6]) for state in states)


def test_a_missing_asset_is_named() -> None:
    with pytest.raises(FileNotFoundError, match=r"can/cann\.urdf"):
        asset_path("can/cann.urdf")
    with pytest.raises(FileNotFoundError, match=r"can/cann\.urdf"):
        SimScene(replace(TASK.scene, bodies=(BodySpec("can", "can/cann.urdf"),)))


LOAD = """
import sys
from dataclasses import replace
from dynaforge.sim import BodySpec, SimScene
from dynaforge.tasks import get_task
SimScene(replace(get_task("can").scene, bodies=(BodySpec("can", sys.argv[1]),)))
"""


@pytest.mark.parametrize(
    "text",
    [
        "<robot name='can'><link name='can'>",
        "not a robot",
        "<robot name='m'><link name='a'><visual><geometry><mesh/></geometry></visual></link></robot>",
        "<robot name='two'><link name='a'/><link name='b'/></robot>",
    ],
    ids=["cut off", "no XML", "no mesh file", "two root links"],
)
def test_a_broken_urdf_is_named_in_one_line(tmp_path: Path, text: str) -> None:
    """In a process of its own: Bullet may crash on what it cannot read."""
    broken = tmp_path / "broken_can.urdf"
    broken.write_text(text)
    done = subprocess.run([sys.executable, "-c", LOAD, str(broken)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    error = done.stderr.strip().splitlines()[-1]
    assert error.startswith("ValueError")
    assert str(broken) in error


def test_closing_twice_is_safe() -> None:
    scene = SimScene(TASK.scene)
    scene.close()
    scene.close()


def test_a_scene_stays_as_it_is_when_another_one_is_used_or_closed(scene: SimScene) -> None:
    def trace(other: SimScene | None) -> list[bytes]:
        states = [bits(scene.reset(CONDITION))]
        for _ in range(10):
            if other is not None:
                other.step(other.robot.q_ready + 0.1, 0.0)
            states.append(bits(scene.step(scene.robot.q_ready, 0.02)))
        return states

    alone = trace(None)
    other = SimScene(TASK.scene)
    other.reset(Condition(TASK.name, 1, CONDITION.difficulty, CONDITION.values))
    assert trace(other) == alone
    other.close()
    assert trace(None) == alone


def test_a_scene_shows_nothing_of_the_engine(scene: SimScene) -> None:
    assert {name for name in vars(scene) if not name.startswith("_")} == {"spec", "robot", "names"}
    assert scene.names == ("robot", "table", "can")
    assert set(scene.overlaps()) == {("robot", "table"), ("robot", "can"), ("table", "can")}
    assert {name for name, _ in scene.link_poses()} == set(scene.names)
    assert scene.link_poses()["robot", "panda_grasptarget"].position == pytest.approx(scene.observe().ee.position)


def test_fingers_are_measured_one_by_one(scene: SimScene) -> None:
    scene.reset(CONDITION)
    closing = [scene.step(scene.robot.q_ready, 0.0) for _ in range(10)][-1]
    position, speed = scene.fingers()
    assert position.sum() == closing.width
    assert (speed < -0.03).all()


def test_a_scene_is_shown_on_one_line(scene: SimScene) -> None:
    assert repr(scene.reset(CONDITION)) == "SceneState(0.000 s, can, hand 80 mm open)"


@pytest.mark.parametrize("make", [copy.deepcopy, copy.copy, pickle.dumps])
def test_a_scene_that_cannot_be_copied_says_so_and_goes_on(make: Callable[[SimScene], object], scene: SimScene) -> None:
    with pytest.raises(TypeError, match="reset it to the same condition"):
        make(scene)
    scene.observe()
