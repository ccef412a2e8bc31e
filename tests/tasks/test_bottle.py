from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hand_made import body, scene_of, view

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Array, Pose
from dynaforge.sim import Condition, SceneState, SimScene
from dynaforge.tasks.bottle import APART, CONDITIONS, HEIGHT, NARROW, REACH, TASK, TURN, WIDE, launch
from dynaforge.tasks.reach import along_arc, arc_to_disc
from dynaforge.tasks.view import heading_frames

DRAWN = [CONDITIONS.draw(np.random.default_rng((8, k)), k % 8, 8) for k in range(200)]
SUCCESS = TASK.phases[-1].done
LYING = scene_of(bottle=body((0.5, 0.0, HEIGHT)))
CONTACTS = ((-APART / 2, WIDE), (APART / 2, NARROW))
"""(position along the axis, radius) of the two circles that touch the table, metres."""


def started(condition: Condition) -> SceneState:
    start = launch(condition)["bottle"]
    return scene_of(
        bottle=body(tuple(start.pose.position), start.pose.rotation, tuple(start.velocity), start.angular_velocity)
    )


def centre(condition: Condition) -> Array:
    """Return the centre of the circle that the bottle should roll on: it is on the side of the thin end."""
    start = launch(condition)["bottle"]
    flat = start.pose.rotation[:, 2] * (1.0, 1.0, 0.0)
    return start.pose.position + TURN * flat / np.linalg.norm(flat)


def test_both_circles_touch_the_table_and_roll_without_slip() -> None:
    for condition in DRAWN:
        start = launch(condition)["bottle"]
        np.testing.assert_allclose(start.pose.rotation.T @ start.pose.rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(start.pose.rotation) == pytest.approx(1.0)
        for along, radius in CONTACTS:
            point = start.pose.apply(np.array((0.0, 0.0, along))) - (0.0, 0.0, radius)
            assert point[2] == pytest.approx(0.0, abs=1e-12)
            slip = start.velocity + np.cross(start.angular_velocity, point - start.pose.position)
            np.testing.assert_allclose(slip, 0.0, atol=1e-12)
        assert np.linalg.norm(start.velocity) == pytest.approx(condition.difficulty)


def test_the_arc_enters_the_reach_after_the_lead_and_crosses_where_the_condition_says() -> None:
    for condition in DRAWN:
        v, start = condition.values, heading_frames(started(condition), None)["bottle"]
        turn = -math.copysign(TURN, v["side"])
        way = v["speed"] * v["lead"]
        assert arc_to_disc(start, turn, REACH) == pytest.approx(way)
        assert np.linalg.norm(along_arc(start, turn, way).position[:2]) == pytest.approx(REACH)
        crossing = np.array((v["cross_x"], v["cross_y"], HEIGHT))
        assert np.linalg.norm(crossing - centre(condition)) == pytest.approx(TURN)


def test_the_whole_circle_keeps_off_the_robot_and_the_start_is_on_the_table() -> None:
    for condition in DRAWN:
        assert np.linalg.norm(centre(condition)[:2]) - TURN > 0.35
        assert launch(condition)["bottle"].pose.position[0] < 1.9 - 0.06


def test_in_physics_it_follows_its_circle() -> None:
    world = SimScene(TASK.scene)
    for condition in DRAWN[:8]:
        world.reset(condition)
        for _ in range(36):
            now = world.step(world.robot.q_ready, 0.08).objects["bottle"]
        assert np.linalg.norm((now.pose.position - centre(condition))[:2]) == pytest.approx(TURN, abs=0.004)
        slip = now.velocity + np.cross(now.angular_velocity, (0.0, 0.0, -HEIGHT))
        assert np.linalg.norm(slip) < 0.02 * condition.difficulty
    world.close()


def test_the_hand_waits_for_it_on_its_arc_where_it_enters_the_reach() -> None:
    for condition in DRAWN:
        target = TASK.phases[0].target(view(started(condition)))
        assert np.linalg.norm((target.position - centre(condition))[:2]) == pytest.approx(TURN)
        if condition.difficulty > 0.1:  # a slower one starts nearer than the clearance
            assert np.linalg.norm(target.position[:2]) == pytest.approx(REACH)
        inward = (centre(condition) - target.position) * (1.0, 1.0, 0.0)
        assert target.rotation[:, 1] @ inward == pytest.approx(0.0, abs=1e-9)


def in_hand(height: float, touching: tuple[bool, bool]) -> SceneState:
    return scene_of(width=0.058, touching={"bottle": touching}, bottle=body((0.5, 0.0, height)))


def test_lifted_ten_centimetres_in_both_fingers_counts() -> None:
    assert SUCCESS(view(in_hand(HEIGHT + 0.101, (True, True)), start=LYING), Pose.identity())


@pytest.mark.parametrize(
    "state",
    [
        pytest.param(in_hand(HEIGHT + 0.09, (True, True)), id="in both fingers, only 9 cm up"),
        pytest.param(in_hand(HEIGHT + 0.15, (True, False)), id="15 cm up, hanging on one finger"),
        pytest.param(in_hand(HEIGHT + 0.15, (False, False)), id="thrown up"),
        pytest.param(in_hand(0.085, (True, True)), id="stood up on its base"),
    ],
)
def test_a_near_miss_does_not_count(state: SceneState) -> None:
    assert not SUCCESS(view(state, start=LYING), Pose.identity())


@pytest.mark.parametrize(
    ("reason", "state"),
    [
        ("dropped", scene_of(bottle=body((0.5, 0.0, -0.2)))),
        ("lost track", scene_of(bottle=body((0.5, 0.7, HEIGHT), velocity=(0.0, 0.5, 0.0)))),
    ],
)
def test_what_makes_success_impossible_has_its_reason(reason: str, state: SceneState) -> None:
    assert [why for why, predicate in TASK.impossible if predicate(view(state), Pose.identity())] == [reason]


def test_nothing_is_impossible_at_the_start() -> None:
    """Half round its circle the bottle is far away, but coming nearer."""
    for condition in DRAWN:
        seen = view(started(condition))
        assert not any(predicate(seen, Pose.identity()) for _, predicate in TASK.impossible)


def test_the_planner_grasps_a_slow_bottle() -> None:
    middle = {name: (low + high) / 2 for name, (low, high) in CONDITIONS.ranges.items()}
    slow = replace(DRAWN[0], difficulty=0.1, values=middle | {"speed": 0.1, "side": 1.0})
    env = ResidualEnv(TASK)
    env.reset(options={"condition": slow})
    done = False
    while not done:
        *_, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    env.close()
    assert info["is_success"], info
