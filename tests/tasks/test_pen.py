from __future__ import annotations

import numpy as np
import pytest

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Array, Pose, rotation_z
from dynaforge.sim import BodyState, Condition, SceneState, SimScene
from dynaforge.sim.spec import Launch, Placement
from dynaforge.tasks.pen import ARM, CONDITIONS, DEPTH, HOLDERS, LENGTH, RACK_FLOOR, TASK, launch
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
    """A pen whose tip is somewhere, a holder at `FLOOR` and a hand that points down above it."""
    still = np.zeros(3)
    middle = np.asarray(tip) + LENGTH / 2 * rotation[:, 2]
    return SceneState(
        time=0.0,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=Pose(DOWN_ALONG_X, FLOOR + (0.0, 0.0, 0.2)),
        width=0.08,
        objects={
            "pen": BodyState(Pose(rotation, middle), still, still),
            "holder": BodyState(Pose(np.eye(3), FLOOR), still, still),
        },
        touching={"pen": touching, "holder": (False, False)},
        on_table={"pen": on_table},
    )


def view(state: SceneState) -> PhaseView:
    frames = heading_frames(state, None)
    return PhaseView(state, state, state, frames, frames)


def impossible(state: SceneState) -> list[str]:
    return [reason for reason, predicate in TASK.impossible if predicate(view(state), Pose.identity())]


def placed(condition: Condition) -> tuple[Launch, Placement, Placement]:
    """Return the launched pen, its rack and the holder."""
    starts = launch(condition)
    pen, rack, holder = starts["pen"], starts["rack"], starts["holder"]
    assert isinstance(pen, Launch)
    assert isinstance(rack, Placement)
    assert isinstance(holder, Placement)
    return pen, rack, holder


def test_the_pen_starts_at_rest_on_the_floor_of_its_rack() -> None:
    for condition in DRAWN:
        pen, rack, _ = placed(condition)
        np.testing.assert_allclose(pen.pose.position - rack.pose.position, (0.0, 0.0, RACK_FLOOR + LENGTH / 2))
        assert not pen.velocity.any()
        assert not pen.angular_velocity.any()


def test_every_holder_is_drawn() -> None:
    assert {placed(condition)[2].variant for condition in DRAWN} == set(range(len(HOLDERS)))


def test_the_peak_speed_is_the_difficulty() -> None:
    for condition in DRAWN:
        holder = placed(condition)[2]
        times = np.linspace(0.0, 40.0, 4001)
        if condition.values["motion"] < 0.0:
            assert set(holder.drives) == {"slide"}
            peak = max(abs(holder.drives["slide"].speed(t)) for t in times)
        else:
            assert set(holder.drives) == {"turn"}
            peak = ARM * abs(holder.drives["turn"].rate)
        assert peak == pytest.approx(condition.difficulty, rel=1e-3)


def test_the_holder_follows_its_drive_and_the_pen_stays_in_its_rack() -> None:
    world = SimScene(TASK.scene)
    for condition in DRAWN[:4]:
        pen, _, holder = placed(condition)
        world.reset(condition)
        for _ in range(12):
            state = world.step(world.robot.q_ready, 0.08)
        drives = holder.drives
        turn = rotation_z(drives["turn"].position(state.time) if "turn" in drives else 0.0)
        slid = drives["slide"].position(state.time) if "slide" in drives else 0.0
        base = holder.pose
        expected = base.position + base.rotation @ (ARM * turn[:, 0] + (0.0, slid, 0.024))
        np.testing.assert_allclose(state.objects["holder"].pose.position, expected, atol=5e-4)
        np.testing.assert_allclose(state.objects["pen"].pose.position, pen.pose.position, atol=1e-3)
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


def test_the_planner_alone_wins_where_the_holder_hardly_moves() -> None:
    env = ResidualEnv(TASK)
    condition = CONDITIONS.draw(np.random.default_rng(3), 0, 20)
    ends = []
    for between in (DRAWN[5], None):  # another episode in between leaves no trace
        env.reset(options={"condition": condition})
        done = False
        while not done:
            *_, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
        assert info["is_success"], info
        ends.append(env.world.state.objects["pen"].pose.position)
        if between is not None:
            env.reset(options={"condition": between})
    np.testing.assert_array_equal(ends[0], ends[1])
    env.close()
