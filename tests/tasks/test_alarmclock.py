from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hand_made import contacts, view

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import ControlStep
from dynaforge.geometry import Pose
from dynaforge.sim import BodyState, Condition, SceneState, SimScene
from dynaforge.sim.contacts import Press
from dynaforge.tasks.alarmclock import CLICK, CONDITIONS, OFF_CENTRE, TASK, launch
from dynaforge.tasks.targets import DOWN_ALONG_Y

BUTTON_HEIGHT = 0.120  # of its top face above the table, metres
DRAWN = [CONDITIONS.draw(np.random.default_rng((5, k)), k % 8, 8) for k in range(64)]
SUCCESS = TASK.phases[-1].done


def test_the_button_moves_on_its_circle_at_the_speed_of_the_condition() -> None:
    """Its speed is the difficulty, its distance from the axis the radius, its height the URDF's, all the time."""
    world = SimScene(TASK.scene)
    for condition in DRAWN[::9]:
        v = condition.values
        axis = np.array((v["centre_x"], v["centre_y"]))
        state = world.reset(condition)
        for _ in range(10):
            body = state.objects["alarmclock"]
            arm = body.pose.position[:2] - axis
            assert np.linalg.norm(arm) == pytest.approx(v["radius"], abs=5e-4)
            assert body.pose.position[2] == pytest.approx(BUTTON_HEIGHT, abs=5e-4)
            assert np.linalg.norm(body.velocity) == pytest.approx(condition.difficulty, rel=0.02)
            turning = float(arm[0] * body.velocity[1] - arm[1] * body.velocity[0])
            assert math.copysign(1.0, turning) == math.copysign(1.0, v["side"])
            state = world.step(world.robot.q_ready, 0.08)
        due = launch(condition)["alarmclock"].drives["turn"].position(state.time)
        arm = state.objects["alarmclock"].pose.position[:2] - axis
        assert math.remainder(math.atan2(arm[1], arm[0]) - due, math.tau) == pytest.approx(0.0, abs=0.01)
    world.close()


def test_the_whole_circle_is_in_reach() -> None:
    for condition in DRAWN:
        v = condition.values
        away = math.hypot(v["centre_x"], v["centre_y"])
        assert away - v["radius"] >= 0.32
        assert away + v["radius"] <= 0.65


def pressed(
    by: float = 0.006, off: float = 0.0, *, width: float = 0.001, touching: tuple[bool, bool] = (True, True)
) -> SceneState:
    """A hand whose axis is `off` metres beside the axis of a button that is pressed in."""
    top = np.array((0.5, 0.0, BUTTON_HEIGHT - by))
    return SceneState(
        time=1.0,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=Pose(DOWN_ALONG_Y, top + (off, 0.0, 0.007)),
        width=width,
        objects={"alarmclock": BodyState(Pose(np.eye(3), top), np.zeros(3), np.zeros(3))},
        touching={"alarmclock": touching},
        on_table={},
        contacts=contacts({"alarmclock": touching}, press=Press(3.0)),
        pressed={"alarmclock": by},
    )


def knocking(state: SceneState, force: float) -> SceneState:
    """The robot also presses on the clock other than with its fingers, newtons."""
    return replace(state, contacts=replace(state.contacts, knocks={"alarmclock": force}))


@pytest.mark.parametrize("touching", [(True, True), (True, False), (False, True)])
def test_a_press_in_the_middle_past_the_click_point_counts(touching: tuple[bool, bool]) -> None:
    assert SUCCESS(view(pressed(CLICK, OFF_CENTRE - 1e-9, touching=touching)), Pose.identity())


@pytest.mark.parametrize(
    "state",
    [
        pytest.param(pressed(CLICK - 1e-4), id="not pressed far enough"),
        pytest.param(pressed(off=OFF_CENTRE + 1e-3), id="pressed off-centre"),
        pytest.param(pressed(by=0.0, off=0.009), id="knocked from the side"),
        pytest.param(pressed(width=0.02), id="pressed with open fingers"),
        pytest.param(pressed(touching=(False, False)), id="pressed by something else"),
        pytest.param(knocking(pressed(), 1.0), id="pressed with a push against the housing"),
        pytest.param(knocking(pressed(touching=(False, False)), 3.0), id="pressed by the palm"),
    ],
)
def test_a_near_miss_does_not_count(state: SceneState) -> None:
    assert not SUCCESS(view(state), Pose.identity())


def test_an_off_centre_press_does_not_click_in_physics() -> None:
    """The hand comes down beside the button of a clock that all but stands still, and misses it."""
    env = ResidualEnv(replace(TASK, residual=replace(TASK.residual, translation=(0.024, 0.0, 0.0))))
    outcomes = []
    for beside in (0.0, 1.0):
        env.reset(options={"condition": easy()})
        done = False
        while not done:
            _, _, done, _, info = env.step(np.array((beside, 0.0, 0.0), np.float32)[: env.action_space.shape[0]])
        outcomes.append((info["is_success"], info["failure"]))
    env.close()
    assert outcomes == [(True, ""), (False, "missed button")]


def test_a_missed_click_is_tried_again_from_above() -> None:
    """Beside the button the program goes back, and the hand comes up before it presses again."""
    env = ResidualEnv(replace(TASK, residual=replace(TASK.residual, translation=(0.028, 0.0, 0.0))))
    heights: dict[int, list[float]] = {1: [], 2: []}
    phases = []

    def look(step: ControlStep) -> None:
        assert step.planned is not None
        phases.append(step.planned.phase)
        if phases.count(2) and step.planned.phase:
            height = step.after.ee.position[2] - step.after.objects["alarmclock"].pose.position[2]
            heights[step.planned.phase].append(float(height))

    with env.world.listening(look):
        env.reset(options={"condition": easy()})
        done = False
        while not done:
            _, _, done, _, info = env.step(np.ones(1, np.float32))
    env.close()
    assert sum(after < before for before, after in itertools.pairwise(phases)) >= 2, "it goes back twice or more"
    assert max(heights[1]) > 0.02
    assert info["checkpoint"] == 2, "no checkpoint is lost, and none is earned twice"


def easy() -> Condition:
    """The slowest clock, in the middle of every other range but the angle."""
    middle = {name: (low + high) / 2 for name, (low, high) in CONDITIONS.ranges.items()}
    speed = CONDITIONS.difficulty_range[0]
    return replace(DRAWN[0], difficulty=speed, values={**middle, "speed": speed, "side": 1.0})
