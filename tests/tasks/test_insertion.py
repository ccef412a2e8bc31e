"""Insertion into a moving hole: Pen and Peg obey the same laws, each with its own sizes and motions."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
import pytest
from hand_made import contacts

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Array, Pose, rotation_z
from dynaforge.sim import BodyState, Condition, SceneState, SimScene
from dynaforge.sim.spec import Launch, Placement
from dynaforge.tasks import Task, peg, pen
from dynaforge.tasks.targets import DOWN_ALONG_X
from dynaforge.tasks.view import PhaseView, heading_frames

STANDING = np.eye(3)
LYING = np.column_stack(((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)))  # z axis along x
FLOOR = np.array((0.45, 0.12, 0.024))


@dataclass(frozen=True)
class Insertion:
    """A task's module, the object, what it is inserted into, and how many sizes that has."""

    module: ModuleType
    grasped: str
    into: str
    sizes: int

    @property
    def task(self) -> Task:
        task: Task = self.module.TASK
        return task

    def drawn(self, n: int = 80) -> list[Condition]:
        """Draw conditions over all of eight strata."""
        return [self.task.conditions.draw(np.random.default_rng((8, k)), k % 8, 8) for k in range(n)]

    def placed(self, condition: Condition) -> tuple[Launch, Placement, Placement]:
        """Return the starts of the object, of its rack, and of what it is inserted into."""
        starts = self.module.launch(condition)
        grasped, rack, into = starts[self.grasped], starts["rack"], starts[self.into]
        assert isinstance(grasped, Launch)
        assert isinstance(rack, Placement)
        assert isinstance(into, Placement)
        return grasped, rack, into

    def scene(
        self,
        above: float = 0.0,
        rotation: Array = STANDING,
        *,
        at: Array = FLOOR,
        touching: tuple[bool, bool] = (False, False),
        on_table: bool = False,
    ) -> SceneState:
        """Return a scene: the tip so far above a place, the hole at `FLOOR`, and a hand that points down over it."""
        still = np.zeros(3)
        middle = np.asarray(at) + (0.0, 0.0, above) + self.module.LENGTH / 2 * rotation[:, 2]
        return SceneState(
            time=0.0,
            q=np.zeros(7),
            dq=np.zeros(7),
            ee=Pose(DOWN_ALONG_X, FLOOR + (0.0, 0.0, self.module.LENGTH / 2 + self.module.GRIP)),
            width=0.08,
            objects={
                self.grasped: BodyState(Pose(rotation, middle), still, still),
                self.into: BodyState(Pose(np.eye(3), FLOOR), still, still),
            },
            touching={self.grasped: touching, self.into: (False, False)},
            on_table={self.grasped: on_table},
            contacts=contacts({self.grasped: touching}, supports=((self.grasped, self.into),)),
        )

    def won(self, state: SceneState) -> bool:
        return bool(self.task.phases[-1].done(view(state), Pose.identity()))

    def impossible(self, state: SceneState) -> list[str]:
        return [reason for reason, predicate in self.task.impossible if predicate(view(state), Pose.identity())]


def view(state: SceneState) -> PhaseView:
    frames = heading_frames(state, None)
    return PhaseView(state=state, entry=state, start=state, frames=frames, entry_frames=frames)


@pytest.fixture(
    params=[Insertion(pen, "pen", "holder", len(pen.HOLDERS)), Insertion(peg, "peg", "hole", len(peg.HOLES))],
    ids=lambda kind: kind.grasped,
)
def kind(request: pytest.FixtureRequest) -> Insertion:
    found: Insertion = request.param
    return found


def test_it_starts_at_rest_on_the_floor_of_its_rack(kind: Insertion) -> None:
    for condition in kind.drawn():
        grasped, rack, _ = kind.placed(condition)
        rests_at = (0.0, 0.0, kind.module.RACK_FLOOR + kind.module.LENGTH / 2)
        np.testing.assert_allclose(grasped.pose.position - rack.pose.position, rests_at)
        assert not grasped.velocity.any()
        assert not grasped.angular_velocity.any()


def test_every_size_is_drawn(kind: Insertion) -> None:
    assert {kind.placed(condition)[2].variant for condition in kind.drawn()} == set(range(kind.sizes))


def test_the_mean_speed_is_the_difficulty(kind: Insertion) -> None:
    for condition in kind.drawn():
        into = kind.placed(condition)[2]
        if condition.values.get("motion", 1.0) < 0.0:
            assert set(into.drives) == {"slide"}
            period = 2 * np.pi / into.drives["slide"].frequency
            mean = np.mean([abs(into.drives["slide"].speed(t)) for t in np.linspace(0.0, period, 400, endpoint=False)])
            assert mean == pytest.approx(condition.difficulty, rel=1e-3)
        else:
            assert set(into.drives) == {"turn"}
            assert kind.module.ARM * abs(into.drives["turn"].rate) == pytest.approx(condition.difficulty)


def test_the_hole_turns_either_way() -> None:
    hole = Insertion(peg, "peg", "hole", len(peg.HOLES))
    for condition in hole.drawn():
        assert hole.placed(condition)[2].drives["turn"].rate * condition.values["phase"] > 0.0  # its sign is the sense


def test_one_follows_its_drive_and_the_other_stays_in_its_rack(kind: Insertion) -> None:
    world = SimScene(kind.task.scene)
    for condition in kind.drawn(4):
        grasped, _, into = kind.placed(condition)
        world.reset(condition)
        for _ in range(12):
            state = world.step(world.robot.q_ready, 0.08)
        drives = into.drives
        turn = rotation_z(drives["turn"].position(state.time) if "turn" in drives else 0.0)
        slid = drives["slide"].position(state.time) if "slide" in drives else 0.0
        expected = into.pose.position + into.pose.rotation @ (kind.module.ARM * turn[:, 0] + (0.0, slid, 0.024))
        np.testing.assert_allclose(state.objects[kind.into].pose.position, expected, atol=5e-4)
        np.testing.assert_allclose(state.objects[kind.grasped].pose.position, grasped.pose.position, atol=1e-3)
        assert not kind.impossible(state)
    world.close()


def test_inserted_to_sixty_percent_and_released_counts(kind: Insertion) -> None:
    assert kind.won(kind.scene(0.399 * kind.module.DEPTH, at=FLOOR + (0.002, 0.0, 0.0)))
    assert kind.won(kind.scene())


def test_a_near_miss_does_not_count(kind: Insertion) -> None:
    depth, length = kind.module.DEPTH, kind.module.LENGTH
    misses = {
        "stuck above 60 % of the depth": kind.scene(0.42 * depth),
        "inside, a finger still on it": kind.scene(touching=(True, False)),
        "standing on the rim": kind.scene(depth),
        "standing beside it": kind.scene(at=FLOOR + (0.04, 0.0, -0.018)),
        "lying under it": kind.scene(-0.018, LYING),
        "wrong way up": kind.scene(length, STANDING * (1.0, -1.0, -1.0)),
    }
    assert not [name for name, state in misses.items() if kind.won(state)]


def test_what_makes_success_impossible_has_its_reason(kind: Insertion) -> None:
    assert kind.impossible(kind.scene(rotation=LYING, at=np.array((0.4, 0.0, 0.01)), on_table=True)) == ["dropped"]
    assert kind.impossible(kind.scene(at=np.array((0.4, 0.0, -0.5)))) == ["dropped"]
    assert not kind.impossible(kind.scene())


def test_the_planner_succeeds_where_the_hole_hardly_moves(kind: Insertion) -> None:
    env = ResidualEnv(kind.task)
    condition = kind.task.conditions.draw(np.random.default_rng(3), 0, 20)
    ends = []
    for between in (kind.drawn(6)[5], None):  # another episode in between leaves no trace
        env.reset(options={"condition": condition})
        done = False
        while not done:
            *_, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
        assert info["is_success"], info
        ends.append(env.world.state.objects[kind.grasped].pose.position)
        if between is not None:
            env.reset(options={"condition": between})
    np.testing.assert_array_equal(ends[0], ends[1])
    env.close()
