from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hand_made import body, scene_of, view

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Pose, rotation_z
from dynaforge.sim import SceneState, SimScene
from dynaforge.tasks.targets import DOWN_ALONG_Y
from dynaforge.tasks.toycar import CONDITIONS, HEIGHT, REACH, TASK, WHEEL_RADIUS, WHEELS, launch

DRAWN = [CONDITIONS.draw(np.random.default_rng((8, k)), k % 8, 8) for k in range(200)]
SUCCESS = TASK.phases[-1].done
STANDING = scene_of(toycar=body((0.5, 0.0, HEIGHT)))


def test_the_car_starts_along_its_heading_with_its_wheels_rolling_without_slip() -> None:
    for condition in DRAWN:
        start = launch(condition)["toycar"]
        forward, left = start.pose.rotation[:, 0], start.pose.rotation[:, 1]
        np.testing.assert_allclose(start.velocity, condition.difficulty * forward, atol=1e-12)
        for wheel in WHEELS:
            rim = start.velocity + np.cross(start.joint_speeds[wheel] * left, (0.0, 0.0, -WHEEL_RADIUS))
            np.testing.assert_allclose(rim, 0.0, atol=1e-12)


def test_the_line_enters_the_reach_after_the_lead_and_crosses_where_the_condition_says() -> None:
    for condition in DRAWN:
        start, v = launch(condition)["toycar"], condition.values
        entry = start.pose.position + v["lead"] * start.velocity
        assert np.linalg.norm(entry[:2]) == pytest.approx(REACH)
        way = np.array((v["cross_x"], v["cross_y"], HEIGHT)) - start.pose.position
        assert np.linalg.norm(np.cross(way, start.velocity)) == pytest.approx(0.0, abs=1e-12)
        assert way @ start.velocity > 0
        assert math.copysign(1.0, start.velocity[1]) == math.copysign(1.0, v["side"])


def test_in_physics_the_fastest_car_coasts_straight_and_keeps_its_speed() -> None:
    """Bullet caps joint speeds at 100 rad/s, which smaller wheels would exceed: the car would skid."""
    fastest = replace(DRAWN[7], values=DRAWN[7].values | {"speed": CONDITIONS.difficulty_range[1]})
    world = SimScene(TASK.scene)
    start = world.reset(fastest).objects["toycar"]
    for _ in range(45):
        now = world.step(world.robot.q_ready, 0.08).objects["toycar"]
    world.close()
    speed = np.linalg.norm(now.velocity)
    assert 0.95 * fastest.values["speed"] < speed < fastest.values["speed"]
    assert now.velocity @ start.velocity / (speed * fastest.values["speed"]) > math.cos(0.01)
    assert now.pose.position[2] == pytest.approx(HEIGHT, abs=5e-4)


def in_hand(height: float, touching: tuple[bool, bool]) -> SceneState:
    hand = Pose(DOWN_ALONG_Y, np.array((0.5, 0.0, height)))
    return scene_of(ee=hand, width=0.056, touching={"toycar": touching}, toycar=body((0.5, 0.0, height)))


def test_lifted_ten_centimetres_in_both_fingers_counts() -> None:
    assert SUCCESS(view(in_hand(HEIGHT + 0.101, (True, True)), start=STANDING), Pose.identity())


@pytest.mark.parametrize(
    "state",
    [
        pytest.param(in_hand(HEIGHT + 0.09, (True, True)), id="in both fingers, only 9 cm up"),
        pytest.param(in_hand(HEIGHT + 0.15, (True, False)), id="15 cm up, hanging on one finger"),
        pytest.param(in_hand(HEIGHT + 0.15, (False, False)), id="thrown up"),
        pytest.param(in_hand(HEIGHT, (True, True)), id="in both fingers, on the table"),
    ],
)
def test_a_near_miss_does_not_count(state: SceneState) -> None:
    assert not SUCCESS(view(state, start=STANDING), Pose.identity())


@pytest.mark.parametrize(
    ("reason", "state"),
    [
        ("dropped", scene_of(toycar=body((0.5, 0.0, -0.2)))),
        ("lost track", scene_of(toycar=body((0.5, 0.7, HEIGHT), velocity=(0.0, 0.5, 0.0)))),
    ],
)
def test_what_makes_success_impossible_has_its_reason(reason: str, state: SceneState) -> None:
    assert [why for why, predicate in TASK.impossible if predicate(view(state), Pose.identity())] == [reason]


def test_nothing_is_impossible_at_the_start() -> None:
    for condition in DRAWN:
        start = launch(condition)["toycar"]
        state = scene_of(toycar=body(tuple(start.pose.position), start.pose.rotation, tuple(start.velocity)))
        assert not any(predicate(view(state), Pose.identity()) for _, predicate in TASK.impossible)


@pytest.mark.parametrize("turned", [0.0, 1.0])
def test_the_fingers_close_across_the_car(turned: float) -> None:
    there = body((0.5, 0.0, HEIGHT), rotation_z(turned), velocity=(math.cos(turned), math.sin(turned), 0.0))
    target = TASK.phases[3].target(view(scene_of(toycar=there)))
    assert abs(target.rotation[:, 1] @ there.pose.rotation[:, 1]) == pytest.approx(1.0)


def test_the_planner_grasps_a_slow_car() -> None:
    middle = {name: (low + high) / 2 for name, (low, high) in CONDITIONS.ranges.items()}
    slow = replace(DRAWN[0], difficulty=0.1, values=middle | {"speed": 0.1, "side": 1.0})
    env = ResidualEnv(TASK)
    env.reset(options={"condition": slow})
    done = False
    while not done:
        *_, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    env.close()
    assert info["is_success"], info
