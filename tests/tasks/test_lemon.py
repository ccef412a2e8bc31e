from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hand_made import Point, contacts, view

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Pose
from dynaforge.sim import BodyState, Condition, SceneState, SimScene
from dynaforge.tasks.lemon import CONDITIONS, FLAT, RADIUS, SLOPE, TASK, launch
from dynaforge.tasks.targets import DOWN_ALONG_X

DRAWN = [CONDITIONS.draw(np.random.default_rng((9, k)), k % 8, 8) for k in range(64)]
SUCCESS = TASK.phases[-1].done


def at_speed(speed: float) -> Condition:
    """A condition in the middle of every other range."""
    middle = {name: (low + high) / 2 for name, (low, high) in CONDITIONS.ranges.items()}
    return replace(DRAWN[0], difficulty=speed, values={**middle, "speed": speed})


def test_the_lemon_is_released_at_rest_on_the_ramp() -> None:
    """It touches the ramp, and its long axis lies across its way."""
    for condition in DRAWN:
        start = launch(condition)
        lemon, ledge = start["lemon"], start["ledge"]
        x, y, z = ledge.pose.inverse().apply(lemon.pose.position)
        above = (x + FLAT) * np.sin(SLOPE) + z * np.cos(SLOPE)
        assert above == pytest.approx(RADIUS)
        assert x < -FLAT
        assert y == pytest.approx(condition.values["offset"])
        np.testing.assert_allclose(lemon.pose.rotation[:, 1], ledge.pose.rotation[:, 1])
        assert not lemon.velocity.any()
        assert not lemon.angular_velocity.any()


def test_it_rolls_straight_and_passes_the_edge_at_the_speed_of_the_condition() -> None:
    """It gives the arm more than a second, whatever its speed."""
    world = SimScene(TASK.scene)
    for speed in (*CONDITIONS.difficulty_range, 0.6, 1.0):
        condition = at_speed(speed)
        state = world.reset(condition)
        ledge = state.objects["ledge"].pose
        while ledge.inverse().apply(state.objects["lemon"].pose.position)[0] < -0.03:
            body, state = state.objects["lemon"], world.step(world.robot.q_ready, 0.08)
            assert state.time < 3.0
        assert np.linalg.norm(body.velocity) == pytest.approx(speed, rel=0.02, abs=0.015)
        assert ledge.inverse().apply(body.pose.position)[1] == pytest.approx(condition.values["offset"], abs=0.003)
        slip = body.velocity + np.cross(body.angular_velocity, (0.0, 0.0, -RADIUS))
        assert np.linalg.norm(slip) < 0.01 * speed + 0.003
        assert state.time > 1.1
    world.close()


def caught(
    where: Point = (0.0, 0.0, 0.0),
    *,
    width: float = 0.056,
    touching: tuple[bool, bool] = (True, True),
    hand: Point = (0.66, 0.0, 0.32),
    on_table: bool = False,
) -> SceneState:
    """A lemon at a place seen from the hand, and who touches it."""
    lemon = BodyState(Pose(np.eye(3), np.array(hand) + where), np.zeros(3), np.zeros(3))
    return SceneState(
        time=2.0,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=Pose(DOWN_ALONG_X, np.array(hand)),
        width=width,
        objects={"lemon": lemon},
        touching={"lemon": touching},
        on_table={"lemon": on_table},
        contacts=contacts({"lemon": touching}),
    )


def test_a_lemon_between_the_fingers_counts() -> None:
    assert SUCCESS(view(caught()), Pose.identity())
    assert TASK.phases[-1].hold == 0.5


@pytest.mark.parametrize(
    "state",
    [
        pytest.param(caught(touching=(True, False)), id="against the left finger"),
        pytest.param(caught(touching=(False, True)), id="against the right finger"),
        pytest.param(caught((0.0, 0.0, 0.03), width=0.0), id="lying on closed fingers"),
        pytest.param(caught((0.02, 0.0, 0.0), width=0.040), id="its near end pinched by the fingertips"),
        pytest.param(caught((0.0, 0.0, 0.06)), id="on the back of the hand"),
        pytest.param(caught(width=0.08), id="in the open hand"),
    ],
)
def test_a_near_miss_does_not_count(state: SceneState) -> None:
    assert not SUCCESS(view(state), Pose.identity())


@pytest.mark.parametrize(
    "state",
    [
        pytest.param(caught((0.0, 0.0, -0.29), on_table=True), id="on the table"),
        pytest.param(caught(hand=(0.66, 0.0, 0.03), on_table=True), id="picked up from the table"),
        pytest.param(caught((0.0, 0.0, -0.6)), id="on the floor"),
    ],
)
def test_a_dropped_lemon_is_a_failure(state: SceneState) -> None:
    assert [why for why, holds in TASK.impossible if holds(view(state), Pose.identity())] == ["dropped"]


def test_nothing_is_impossible_in_the_hand_or_at_the_start() -> None:
    states = [caught()]
    for condition in DRAWN:
        states.append(caught(hand=tuple(launch(condition)["lemon"].pose.position)))
    assert not any(holds(view(state), Pose.identity()) for state in states for _, holds in TASK.impossible)


def test_the_planner_catches_at_a_middle_speed_and_episodes_repeat() -> None:
    env = ResidualEnv(TASK)
    ends = []
    for speed in (0.8, 1.5, 0.8):
        env.reset(options={"condition": at_speed(speed)})
        done = False
        while not done:
            _, _, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
        ends.append((info["is_success"], tuple(env.world.state.objects["lemon"].pose.position)))
    env.close()
    assert ends[0][0]
    assert ends[0] == ends[2]
