from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hand_made import contacts

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Pose
from dynaforge.sim import BodyState, SceneState, SimScene
from dynaforge.sim.spec import Drive
from dynaforge.tasks.carriers import carried
from dynaforge.tasks.peach import ARM, BOWL_X, BOWL_Y, CONDITIONS, RADIUS, REACH, SWING, TASK, launch
from dynaforge.tasks.reach import distance_to_disc
from dynaforge.tasks.targets import DOWN_ALONG_X
from dynaforge.tasks.view import PhaseView, heading_frames

DRAWN = [CONDITIONS.draw(np.random.default_rng((8, k)), k % 8, 8) for k in range(200)]
SUCCESS = TASK.phases[-1].done
BOWL = np.array((0.4, 0.1, 0.024))


def seen(
    peach: tuple[float, float, float], velocity: tuple[float, float, float] = (0.0, 0.0, 0.0), left: bool = False
) -> PhaseView:
    """A peach at a place relative to a bowl that slides at 0.2 m/s, with a velocity relative to it."""
    drift = np.array((0.0, 0.2, 0.0))
    state = SceneState(
        time=0.0,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=Pose(DOWN_ALONG_X, BOWL + (0.0, 0.0, 0.2)),
        width=0.08,
        objects={
            "peach": BodyState(Pose(np.eye(3), BOWL + peach), drift + velocity, np.zeros(3)),
            "bowl": BodyState(Pose(np.eye(3), BOWL), drift, np.zeros(3)),
        },
        touching={"peach": (left, False), "bowl": (False, False)},
        on_table={"peach": False},
        contacts=contacts({"peach": (left, False)}, supports=(("peach", "bowl"),)),
    )
    frames = heading_frames(state, None)
    return PhaseView(state=state, entry=state, start=state, frames=frames, entry_frames=frames)


def test_the_peach_starts_rolling_without_slip_and_enters_the_reach_in_time() -> None:
    for condition in DRAWN:
        start = launch(condition)["peach"]
        contact = start.velocity + np.cross(start.angular_velocity, (0.0, 0.0, -RADIUS))
        np.testing.assert_allclose(contact, 0.0, atol=1e-12)
        assert np.linalg.norm(start.velocity) == pytest.approx(condition.difficulty)
        entry = distance_to_disc(Pose(start.pose.rotation, start.pose.position), REACH)
        assert entry / condition.difficulty == pytest.approx(condition.values["lead"])


def test_the_bowl_never_meets_the_rolling_peach() -> None:
    for condition in DRAWN:
        start = launch(condition)["peach"]
        x, y, _ = start.pose.rotation[:, 0]
        sides = BOWL_Y * np.sign(condition.values["side"]) - start.pose.position[1]
        off_line = abs((BOWL_X - start.pose.position[0]) * y - sides * x)
        assert off_line > max(ARM, SWING) + 0.055 + RADIUS


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_bowl_follows_its_drive(sign: float) -> None:
    """The fastest bowl of each kind of motion is at every control step where its joints are due."""
    condition = max(DRAWN, key=lambda c: sign * c.values["bowl_speed"])
    placement = launch(condition)["bowl"]
    world = SimScene(TASK.scene)
    state = world.reset(condition)
    speeds = []
    for _ in range(75):
        drives = {name: Drive(start=drive.position(state.time)) for name, drive in placement.drives.items()}
        due, _, _ = carried(replace(placement, drives=drives), arm=ARM, height=0.024)
        np.testing.assert_allclose(state.objects["bowl"].pose.position, due.position, atol=1e-3)
        state = world.step(world.robot.q_ready, 0.08)
        speeds.append(np.linalg.norm(state.objects["bowl"].velocity))
    world.close()
    assert max(speeds) == pytest.approx(abs(condition.values["bowl_speed"]), rel=0.03)


def test_a_peach_at_rest_in_the_moving_bowl_counts() -> None:
    assert SUCCESS(seen((0.016, 0.0, RADIUS)), Pose.identity())


@pytest.mark.parametrize(
    "view",
    [
        pytest.param(seen((0.0, 0.0, RADIUS), left=True), id="in the bowl, a finger still on it"),
        pytest.param(seen((0.0, 0.0, RADIUS), (0.0, 0.1, 0.0)), id="rolling through the bowl"),
        pytest.param(seen((0.0, 0.0, RADIUS), (0.0, -0.2, 0.0)), id="standing in the world, the bowl moving below"),
        pytest.param(seen((0.02, 0.0, RADIUS + 0.012)), id="on the rim"),
        pytest.param(seen((0.09, 0.0, 0.007)), id="on the table beside the bowl"),
        pytest.param(seen((0.0, 0.0, 0.08)), id="let go above the bowl"),
    ],
)
def test_a_near_miss_does_not_count(view: PhaseView) -> None:
    assert not SUCCESS(view, Pose.identity())


@pytest.mark.parametrize(
    ("reason", "view"),
    [("dropped", seen((0.0, 0.0, -0.3))), ("lost track", seen((0.3, 0.6, 0.0), (0.0, 0.5, 0.0)))],
)
def test_what_makes_success_impossible_has_its_reason(reason: str, view: PhaseView) -> None:
    assert [why for why, predicate in TASK.impossible if predicate(view, Pose.identity())] == [reason]


def test_the_planner_succeeds_with_a_slow_peach() -> None:
    env = ResidualEnv(TASK)
    env.reset(options={"condition": next(CONDITIONS.stream("val", n_strata=8))})
    done, info = False, {}
    while not done:
        _, _, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    env.close()
    assert info["is_success"]
