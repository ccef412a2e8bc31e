from __future__ import annotations

import numpy as np
import pytest
from hand_made import contacts

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Pose, matrix_from_rotvec
from dynaforge.sim import BodyState, SceneState, SimScene
from dynaforge.tasks.block import (
    CONDITIONS,
    HALF,
    PAD_ARM,
    PAD_SWING,
    PAD_Y,
    TASK,
    TOP,
    TRAY_ARM,
    TRAY_SWING,
    TRAY_Y,
    launch,
)
from dynaforge.tasks.carriers import carried
from dynaforge.tasks.targets import DOWN_ALONG_X
from dynaforge.tasks.view import PhaseView, heading_frames

DRAWN = [CONDITIONS.draw(np.random.default_rng((8, k)), k % 8, 8) for k in range(200)]
SUCCESS = TASK.phases[-1].done
PAD = np.array((0.5, 0.2, TOP))
SPIN = np.array((0.0, 0.0, 2.0))
DRIFT = np.array((0.0, 0.16, 0.0))


def seen(
    block: tuple[float, float, float],
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    tilt: float = 0.0,
    left: bool = False,
    on_table: bool = False,
) -> PhaseView:
    """A block at a place relative to a pad that moves and turns, with a velocity relative to the pad where it is."""
    moving = DRIFT + np.cross(SPIN, block) + velocity
    state = SceneState(
        time=0.0,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=Pose(DOWN_ALONG_X, PAD + (0.0, 0.0, 0.2)),
        width=0.08,
        objects={
            "block": BodyState(Pose(matrix_from_rotvec(np.array((tilt, 0.0, 0.0))), PAD + block), moving, SPIN),
            "tray": BodyState(Pose.identity(), np.zeros(3), np.zeros(3)),
            "pad": BodyState(Pose(np.eye(3), PAD), DRIFT, SPIN),
        },
        touching={"block": (left, False), "tray": (False, False), "pad": (False, False)},
        on_table={"block": on_table},
        contacts=contacts({"block": (left, False)}, supports=(("block", "pad"),)),
    )
    frames = heading_frames(state, None)
    return PhaseView(state=state, entry=state, start=state, frames=frames, entry_frames=frames)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_block_rides_on_the_tray_without_sliding(sign: float) -> None:
    """The fastest draw of each kind of motion."""
    kind = [c for c in DRAWN if np.sign(c.values["tray_motion"]) == sign]
    condition = max(kind, key=lambda c: c.difficulty)
    world = SimScene(TASK.scene)
    state = world.reset(condition)
    place = state.objects["tray"].pose.inverse() @ state.objects["block"].pose
    speeds = []
    for _ in range(75):
        state = world.step(world.robot.q_ready, 0.08)
        speeds.append(np.linalg.norm(state.objects["tray"].velocity))
    world.close()
    now = state.objects["tray"].pose.inverse() @ state.objects["block"].pose
    assert np.linalg.norm(now.position - place.position) < 0.004
    peak = condition.difficulty * (np.pi / 2 if sign < 0.0 else 1.0)  # the difficulty is the mean speed
    assert max(speeds) == pytest.approx(peak, rel=0.05)


def test_tray_and_pad_start_where_their_drives_say() -> None:
    world = SimScene(TASK.scene)
    for condition in DRAWN[:4]:
        state, placed = world.reset(condition), launch(condition)
        for name, arm in (("tray", TRAY_ARM), ("pad", PAD_ARM)):
            pose, velocity, spin = carried(placed[name], arm=arm, height=TOP)
            np.testing.assert_allclose(state.objects[name].pose.position, pose.position, atol=1e-6)
            np.testing.assert_allclose(state.objects[name].pose.rotation, pose.rotation, atol=1e-6)
            np.testing.assert_allclose(state.objects[name].velocity, velocity, atol=1e-3)
            np.testing.assert_allclose(state.objects[name].angular_velocity, spin, atol=1e-2)
    world.close()


def test_tray_and_pad_keep_to_their_sides() -> None:
    """Their corners, 71 and 64 mm from the middle, stay clear of each other."""
    nearest = TRAY_Y - max(TRAY_ARM, TRAY_SWING) + PAD_Y - max(PAD_ARM, PAD_SWING)
    assert nearest > 0.071 + 0.064
    for condition in DRAWN:
        side, placed = np.sign(condition.values["side"]), launch(condition)
        assert carried(placed["tray"], arm=TRAY_ARM, height=TOP)[0].position[1] * side > 0.04
        assert carried(placed["pad"], arm=PAD_ARM, height=TOP)[0].position[1] * side < -0.10


def test_a_block_at_rest_on_the_moving_pad_counts() -> None:
    assert SUCCESS(seen((0.02, 0.0, HALF)), Pose.identity())


@pytest.mark.parametrize(
    "view",
    [
        pytest.param(seen((0.0, 0.0, HALF), left=True), id="on the pad, a finger still on it"),
        pytest.param(seen((0.03, 0.0, HALF)), id="on the edge of the pad"),
        pytest.param(seen((0.0, 0.0, HALF + 0.004), tilt=0.3), id="tilted"),
        pytest.param(seen((0.0, 0.0, HALF), (0.1, 0.0, 0.0)), id="sliding across the pad"),
        pytest.param(seen((0.0, 0.0, HALF + 0.02)), id="let go above the pad"),
    ],
)
def test_a_near_miss_does_not_count(view: PhaseView) -> None:
    assert not SUCCESS(view, Pose.identity())


@pytest.mark.parametrize(
    ("reason", "view"),
    [("dropped", seen((0.0, 0.0, -0.3))), ("knocked off", seen((0.1, 0.0, HALF - TOP), on_table=True))],
)
def test_what_makes_success_impossible_has_its_reason(reason: str, view: PhaseView) -> None:
    assert [why for why, predicate in TASK.impossible if predicate(view, Pose.identity())] == [reason]


def test_the_planner_succeeds_with_a_slow_tray() -> None:
    env = ResidualEnv(TASK)
    stream = CONDITIONS.stream("val", n_strata=8)
    conditions = [next(stream) for _ in range(9)]
    env.reset(options={"condition": conditions[8]})
    done, info = False, {}
    while not done:
        _, _, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    env.close()
    assert info["is_success"]
