from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hand_made import scene, view

from dynaforge.geometry import Pose
from dynaforge.sim import SceneState, SimScene
from dynaforge.tasks.can import CONDITIONS, RADIUS, REACH, TASK, launch
from dynaforge.tasks.reach import distance_to_disc
from dynaforge.tasks.view import heading_frames

DRAWN = [CONDITIONS.draw(np.random.default_rng((8, k)), k % 8, 8) for k in range(400)]
SUCCESS = TASK.phases[-1].done


def test_the_can_starts_rolling_without_slip() -> None:
    """The point of the can that touches the table stands still."""
    for condition in DRAWN:
        start = launch(condition)["can"]
        contact = start.velocity + np.cross(start.angular_velocity, (0.0, 0.0, -RADIUS))
        np.testing.assert_allclose(contact, 0.0, atol=1e-12)
        assert np.linalg.norm(start.velocity) == pytest.approx(condition.difficulty)
        assert start.pose.position[2] == RADIUS


def test_the_can_lies_on_its_side_across_its_way() -> None:
    for condition in DRAWN:
        start = launch(condition)["can"]
        axis = start.pose.rotation[:, 2]
        assert axis @ start.velocity == pytest.approx(0.0, abs=1e-12)
        assert axis[2] == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(start.pose.rotation.T @ start.pose.rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(start.pose.rotation) == pytest.approx(1.0)


def test_rolling_goes_on_without_slip_in_physics() -> None:
    world = SimScene(TASK.scene)
    world.reset(DRAWN[5])
    for _ in range(30):
        body = world.step(world.robot.q_ready, 0.08).objects["can"]
        contact = body.velocity + np.cross(body.angular_velocity, (0.0, 0.0, -RADIUS))
        assert np.linalg.norm(contact) < 0.01 * DRAWN[5].difficulty + 0.003
    world.close()


def test_side_is_the_side_that_the_can_comes_from() -> None:
    """A positive side rolls toward +y, so it comes from -y."""
    ends = {name: (low + high) / 2 for name, (low, high) in CONDITIONS.ranges.items()}
    for side in (-1.0, 1.0):
        condition = replace(DRAWN[0], values={**ends, "side": side, "heading": 0.0})
        start = launch(condition)["can"]
        assert math.copysign(1.0, start.velocity[1]) == side
        assert math.copysign(1.0, start.pose.position[1]) == -side
        assert start.velocity[0] == pytest.approx(0.0, abs=1e-12)


def test_the_line_crosses_the_workspace_where_the_condition_says() -> None:
    for condition in DRAWN:
        start = launch(condition)["can"]
        way = np.array((condition.values["cross_x"], condition.values["cross_y"], RADIUS)) - start.pose.position
        assert np.linalg.norm(np.cross(way, start.velocity)) == pytest.approx(0.0, abs=1e-12)
        assert way @ start.velocity > 0
        entry = start.pose.position + condition.values["lead"] * start.velocity
        np.testing.assert_allclose(np.linalg.norm(entry[:2]), REACH)


def test_the_arm_has_eight_tenths_of_a_second_before_the_can_enters_the_reach() -> None:
    leads = []
    for condition in DRAWN:
        state = scene(tuple(launch(condition)["can"].pose.position), tuple(launch(condition)["can"].velocity))
        leads.append(distance_to_disc(heading_frames(state, None)["can"], REACH) / condition.difficulty)
    assert min(leads) >= 0.8


def judged(*states: SceneState) -> list[bool]:
    """Tell of each state whether a lazy or a proper predicate would call it a success now."""
    return [SUCCESS(view(state, start=scene()), Pose.identity()) for state in states]


def lifted(by: float, touching: tuple[bool, bool]) -> SceneState:
    return scene((0.5, 0.0, RADIUS + by), hand=(0.5, 0.0, RADIUS + by), touching=touching)


def test_lifted_ten_centimetres_in_both_fingers_counts() -> None:
    assert judged(lifted(0.10 + 1e-9, (True, True))) == [True]


@pytest.mark.parametrize(
    "state",
    [
        pytest.param(lifted(0.09, (True, True)), id="in both fingers, only 9 cm up"),
        pytest.param(lifted(0.15, (True, False)), id="15 cm up, hanging on the left finger"),
        pytest.param(lifted(0.15, (False, True)), id="15 cm up, hanging on the right finger"),
        pytest.param(lifted(0.15, (False, False)), id="15 cm up, lying on the back of the hand"),
        pytest.param(scene((0.5, 0.0, 0.2), (0.0, 0.0, 1.0)), id="thrown up"),
        pytest.param(scene((0.5, 0.0, RADIUS), hand=(0.5, 0.0, 0.5), touching=(True, True)), id="hand up, can down"),
    ],
)
def test_a_near_miss_does_not_count(state: SceneState) -> None:
    assert judged(state) == [False]


@pytest.mark.parametrize(
    ("reason", "state"),
    [
        ("dropped", scene((0.5, 0.0, -0.2))),
        ("lost track", scene((0.5, 0.7, RADIUS), (0.0, 0.5, 0.0))),
    ],
)
def test_what_makes_success_impossible_has_its_reason(reason: str, state: SceneState) -> None:
    holding = [why for why, predicate in TASK.impossible if predicate(view(state), Pose.identity())]
    assert holding == [reason]


def test_nothing_is_impossible_at_the_start_or_in_the_hand() -> None:
    for condition in DRAWN:
        start = launch(condition)["can"]
        for state in (scene(tuple(start.pose.position), tuple(start.velocity)), lifted(0.15, (True, True))):
            assert not any(predicate(view(state), Pose.identity()) for _, predicate in TASK.impossible)
