from __future__ import annotations

import numpy as np
import pytest

from dynaforge.geometry import Pose
from dynaforge.planning import ArmKinematics, CollisionModel, Obstacle
from dynaforge.planning.collision import bisection_order
from dynaforge.sim.robot import RobotDescription


def at(x: float, y: float, z: float) -> Pose:
    return Pose(np.eye(3), np.array((x, y, z)))


def test_the_ready_pose_is_free(robot: RobotDescription, collision: CollisionModel) -> None:
    assert not collision.in_collision(robot.q_ready)
    assert collision.colliding_pair(robot.q_ready) is None


@pytest.mark.parametrize(("height", "touches"), [(0.05, False), (0.012, False), (0.004, True), (-0.02, True)])
def test_fingers_touch_the_table_seven_millimetres_below_the_end_effector_frame(
    height: float,
    touches: bool,
    robot: RobotDescription,
    kinematics: ArmKinematics,
    collision: CollisionModel,
    ready: Pose,
) -> None:
    goal = Pose(ready.rotation, np.array((0.5, 0.0, height)))
    q = kinematics.solve(goal, robot.q_ready, max_iterations=50).q
    assert collision.in_collision(q) is touches
    pair = collision.colliding_pair(q)
    assert (pair is not None) is touches
    if pair:
        assert pair[1] == "table"
        assert "finger" in pair[0]


def test_the_arm_cannot_fold_into_itself(robot: RobotDescription) -> None:
    folded = np.array((0.0, -0.5, 0.0, -3.04, 0.0, 0.6, 0.0))
    pair = CollisionModel(robot, table=None).colliding_pair(folded)
    assert pair is not None
    assert all(name.startswith("panda_") for name in pair)


@pytest.mark.parametrize(("shape", "size"), [("box", (0.1, 0.1, 0.1)), ("cylinder", (0.05, 0.1)), ("sphere", (0.05,))])
def test_a_fixture_is_met_exactly_where_it_stands(
    shape: str, size: tuple[float, ...], robot: RobotDescription, ready: Pose
) -> None:
    # All three shapes reach 5 cm from their centre along z; the finger tips are about 7 mm below the frame.
    for gap, touches in ((0.0, True), (0.052, True), (0.064, False)):
        x, y, z = ready.position.tolist()
        fixture = Obstacle("post", shape, size, at(x, y + 0.04, z - gap))  # type: ignore[arg-type]
        model = CollisionModel(robot, fixtures=[fixture])
        assert model.in_collision(robot.q_ready) is touches
        pair = model.colliding_pair(robot.q_ready)
        assert (pair[1] if pair else None) == ("post" if touches else None)


def test_clearance_counts_what_is_near_as_touching(robot: RobotDescription, ready: Pose) -> None:
    x, y, z = ready.position.tolist()
    model = CollisionModel(robot, fixtures=[Obstacle("post", "sphere", (0.05,), at(x, y + 0.04, z - 0.064))])
    assert not model.in_collision(robot.q_ready)
    assert CollisionModel(
        robot, fixtures=[Obstacle("post", "sphere", (0.05,), at(x, y + 0.04, z - 0.064))], clearance=0.03
    ).in_collision(robot.q_ready, clear=True)


def test_an_edge_is_blocked_by_what_stands_between_free_ends(robot: RobotDescription) -> None:
    left, right = robot.q_ready.copy(), robot.q_ready.copy()
    left[0], right[0] = -0.8, 0.8
    model = CollisionModel(robot, fixtures=[Obstacle("wall", "box", (0.4, 0.02, 0.8), at(0.5, 0.0, 0.4))])
    assert not model.in_collision(left)
    assert not model.in_collision(right)
    assert not model.edge_free(left, right)
    assert CollisionModel(robot).edge_free(left, right)


def test_edges_are_checked_at_both_ends_and_everywhere_between() -> None:
    for n in (1, 2, 3, 7, 8, 9, 100):
        order = bisection_order(n)
        np.testing.assert_allclose(order[:2], (0.0, 1.0))
        np.testing.assert_allclose(np.sort(order), np.arange(n + 1) / n)


@pytest.mark.parametrize(
    ("shape", "size", "message"),
    [
        ("cone", (0.1, 0.1), "box, cylinder, sphere"),
        ("box", (0.1, 0.1), "3 positive"),
        ("sphere", (-0.1,), "1 positive"),
        ("cylinder", (0.1, np.nan), "2 positive"),
    ],
)
def test_malformed_obstacles_are_refused_by_name(shape: str, size: tuple[float, ...], message: str) -> None:
    with pytest.raises(ValueError, match=f"'post'.*{message}"):
        Obstacle("post", shape, size, at(0, 0, 0))  # type: ignore[arg-type]


def test_two_obstacles_of_one_name_are_refused(robot: RobotDescription) -> None:
    with pytest.raises(ValueError, match="unique"):
        CollisionModel(robot, fixtures=[Obstacle("table", "sphere", (0.1,), at(0.5, 0, 1.0))])
