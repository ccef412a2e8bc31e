from __future__ import annotations

import numpy as np
import pytest

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Array, Pose, rotation_z
from dynaforge.sim import BodyState, Condition, SceneState, SimScene
from dynaforge.sim.spec import Launch, Placement
from dynaforge.tasks.peg import ARM, CONDITIONS, DEPTH, HOLES, LENGTH, RACK_FLOOR, TASK, launch
from dynaforge.tasks.targets import DOWN_ALONG_X
from dynaforge.tasks.view import PhaseView, heading_frames

DRAWN = [CONDITIONS.draw(np.random.default_rng((8, k)), k % 8, 8) for k in range(80)]
SUCCESS = TASK.phases[-1].done
STANDING = np.eye(3)
LYING = np.column_stack(((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)))  # z axis along x
FLOOR = np.array((0.45, 0.12, 0.024))


def scene(
    tip: Array, rotation: Array = STANDING, *, touching: tuple[bool, bool] = (False, False), on_table: bool = False
) -> SceneState:
    """A peg whose tip is somewhere, a hole at `FLOOR` and a hand that points down above it."""
    still = np.zeros(3)
    middle = np.asarray(tip) + LENGTH / 2 * rotation[:, 2]
    return SceneState(
        time=0.0,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=Pose(DOWN_ALONG_X, FLOOR + (0.0, 0.0, 0.2)),
        width=0.08,
        objects={
            "peg": BodyState(Pose(rotation, middle), still, still),
            "hole": BodyState(Pose(np.eye(3), FLOOR), still, still),
        },
        touching={"peg": touching, "hole": (False, False)},
        on_table={"peg": on_table},
    )


def view(state: SceneState) -> PhaseView:
    frames = heading_frames(state, None)
    return PhaseView(state, state, state, frames, frames)


def impossible(state: SceneState) -> list[str]:
    return [reason for reason, predicate in TASK.impossible if predicate(view(state), Pose.identity())]


def placed(condition: Condition) -> tuple[Launch, Placement, Placement]:
    """Return the launched peg, its rack and the hole."""
    starts = launch(condition)
    peg, rack, hole = starts["peg"], starts["rack"], starts["hole"]
    assert isinstance(peg, Launch)
    assert isinstance(rack, Placement)
    assert isinstance(hole, Placement)
    return peg, rack, hole


def test_the_peg_starts_at_rest_on_the_floor_of_its_rack() -> None:
    for condition in DRAWN:
        peg, rack, _ = placed(condition)
        np.testing.assert_allclose(peg.pose.position - rack.pose.position, (0.0, 0.0, RACK_FLOOR + LENGTH / 2))
        assert not peg.velocity.any()
        assert not peg.angular_velocity.any()


def test_every_hole_is_drawn() -> None:
    assert {placed(condition)[2].variant for condition in DRAWN} == set(range(len(HOLES)))


def test_the_speed_of_the_hole_is_the_difficulty() -> None:
    for condition in DRAWN:
        hole = placed(condition)[2]
        assert set(hole.drives) == {"turn"}
        assert abs(ARM * hole.drives["turn"].rate) == pytest.approx(condition.difficulty)
        assert hole.drives["turn"].rate * condition.values["phase"] > 0.0  # its sign is the sense of turning


def test_the_hole_follows_its_drive_and_the_peg_stays_in_its_rack() -> None:
    world = SimScene(TASK.scene)
    for condition in DRAWN[:4]:
        peg, _, hole = placed(condition)
        world.reset(condition)
        for _ in range(12):
            state = world.step(world.robot.q_ready, 0.08)
        drives = hole.drives
        turn = rotation_z(drives["turn"].position(state.time) if "turn" in drives else 0.0)
        slid = drives["slide"].position(state.time) if "slide" in drives else 0.0
        base = hole.pose
        expected = base.position + base.rotation @ (ARM * turn[:, 0] + (0.0, slid, 0.024))
        np.testing.assert_allclose(state.objects["hole"].pose.position, expected, atol=5e-4)
        np.testing.assert_allclose(state.objects["peg"].pose.position, peg.pose.position, atol=1e-3)
        assert not impossible(state)
    world.close()


def test_inserted_to_sixty_percent_and_released_counts() -> None:
    assert SUCCESS(view(scene(FLOOR + (0.002, 0.0, 0.399 * DEPTH))), Pose.identity())
    assert SUCCESS(view(scene(FLOOR)), Pose.identity())


@pytest.mark.parametrize(
    "state",
    [
        pytest.param(scene(FLOOR + (0.0, 0.0, 0.42 * DEPTH)), id="stuck above 60 % of the depth"),
        pytest.param(scene(FLOOR, touching=(True, False)), id="inside, a finger still on it"),
        pytest.param(scene(FLOOR + (0.0, 0.0, DEPTH)), id="standing on the rim"),
        pytest.param(scene(FLOOR + (0.04, 0.0, -0.018)), id="standing beside it"),
        pytest.param(scene(FLOOR - (0.0, 0.0, 0.018), LYING), id="lying under it"),
        pytest.param(scene(FLOOR + (0.0, 0.0, LENGTH), STANDING * (1.0, -1.0, -1.0)), id="wrong way up"),
    ],
)
def test_a_near_miss_does_not_count(state: SceneState) -> None:
    assert not SUCCESS(view(state), Pose.identity())


def test_what_makes_success_impossible_has_its_reason() -> None:
    assert impossible(scene(np.array((0.4, 0.0, 0.01)), LYING, on_table=True)) == ["dropped"]
    assert impossible(scene(np.array((0.4, 0.0, -0.5)))) == ["dropped"]
    assert not impossible(scene(FLOOR))


def test_the_planner_alone_wins_where_the_hole_hardly_moves() -> None:
    env = ResidualEnv(TASK)
    condition = CONDITIONS.draw(np.random.default_rng(3), 0, 20)
    ends = []
    for between in (DRAWN[5], None):  # another episode in between leaves no trace
        env.reset(options={"condition": condition})
        done = False
        while not done:
            *_, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
        assert info["is_success"], info
        ends.append(env.world.state.objects["peg"].pose.position)
        if between is not None:
            env.reset(options={"condition": between})
    np.testing.assert_array_equal(ends[0], ends[1])
    env.close()
