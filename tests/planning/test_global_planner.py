from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from dynaforge.geometry import Array, JointState, JointTrajectory, Pose, matrix_from_rotvec
from dynaforge.planning import ArmKinematics, CollisionModel, GlobalPlanner, Obstacle, PlanFailure
from dynaforge.sim.robot import RobotDescription

DT = 1 / 30
REST = np.zeros(7)
WALL = Obstacle("wall", "box", (0.3, 0.04, 0.6), Pose(np.eye(3), np.array((0.5, 0.0, 0.3))))


@pytest.fixture(scope="module")
def planner(robot: RobotDescription, kinematics: ArmKinematics, collision: CollisionModel) -> GlobalPlanner:
    return GlobalPlanner(robot, kinematics, collision, dt=DT)


@pytest.fixture(scope="module")
def walled(robot: RobotDescription, kinematics: ArmKinematics) -> GlobalPlanner:
    return GlobalPlanner(robot, kinematics, CollisionModel(robot, fixtures=[WALL]), dt=DT)


def random_goal(ready: Pose, rng: np.random.Generator) -> Pose:
    turn = matrix_from_rotvec(rng.uniform(-0.4, 0.4, 3))
    return Pose(ready.rotation @ turn, rng.uniform((0.35, -0.35, 0.05), (0.6, 0.35, 0.5)))


def random_start(planner: GlobalPlanner, rng: np.random.Generator) -> Array:
    while True:
        q = planner.robot.q_ready + rng.uniform(-0.8, 0.8, 7)
        q = np.clip(q, planner.robot.q_lower, planner.robot.q_upper)
        if not planner.collision.in_collision(q):
            return q


def assert_inside_limits(trajectory: JointTrajectory, robot: RobotDescription) -> None:
    """Finite differences of the samples, and the samples' own derivatives, keep every limit."""
    q, dq, ddq = trajectory.q, trajectory.dq, trajectory.ddq
    assert trajectory.dt == DT
    assert (q >= robot.q_lower).all()
    assert (q <= robot.q_upper).all()
    velocity = np.diff(q, axis=0) / DT
    # Half a step lies between the given velocity and the first difference, and at the end likewise.
    padded = np.concatenate((dq[:1], velocity, dq[-1:]))
    spans = np.full((len(padded) - 1, 1), DT)
    spans[0] = spans[-1] = DT / 2
    for values, limit in ((velocity, robot.dq_max), (dq, robot.dq_max), (ddq, robot.ddq_max)):
        assert (np.abs(values) <= limit * (1 + 1e-9)).all()
    assert (np.abs(np.diff(padded, axis=0) / spans) <= robot.ddq_max * (1 + 1e-6)).all()


def assert_free(trajectory: JointTrajectory, collision: CollisionModel) -> None:
    """Every straight line between samples, as the controller follows it, is free at 4 mrad."""
    for a, b in pairwise(trajectory.q):
        n = math.ceil(float(np.abs(b - a).max()) / 0.004) + 1
        assert not any(collision.in_collision(a + s * (b - a)) for s in np.linspace(0.0, 1.0, n))


def assert_arrives(trajectory: JointTrajectory, target: Pose, kinematics: ArmKinematics) -> None:
    end = kinematics.forward(trajectory.q[-1])
    np.testing.assert_allclose(end.position, target.position, atol=2e-4)
    np.testing.assert_allclose(end.rotation, target.rotation, atol=2e-3)
    np.testing.assert_array_equal(trajectory.dq[-1], REST)
    np.testing.assert_array_equal(trajectory.ddq[-1], REST)


def test_trajectories_keep_limits_and_touch_nothing(planner: GlobalPlanner, ready: Pose) -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        q, target = random_start(planner, rng), random_goal(ready, rng)
        trajectory = planner.plan(JointState.at_rest(q), target, rng=rng)
        np.testing.assert_array_equal(trajectory.q[0], q)
        assert_inside_limits(trajectory, planner.robot)
        assert_free(trajectory, planner.collision)
        assert_arrives(trajectory, target, planner.kinematics)


def test_a_moving_arm_brakes_first_and_keeps_every_limit(planner: GlobalPlanner, ready: Pose) -> None:
    robot = planner.robot
    for seed in range(20):
        rng = np.random.default_rng(seed)
        q, target = robot.q_ready + rng.uniform(-0.2, 0.2, 7), random_goal(ready, rng)
        dq, ddq = rng.uniform(-0.3, 0.3, 7) * robot.dq_max, rng.uniform(-0.5, 0.5, 7) * robot.ddq_max
        trajectory = planner.plan(JointState(q, dq, ddq), target, rng=rng)
        for sample, given in ((trajectory.q, q), (trajectory.dq, dq), (trajectory.ddq, ddq)):
            np.testing.assert_allclose(sample[0], given, atol=1e-12)
        assert_inside_limits(trajectory, robot)
        assert_arrives(trajectory, target, planner.kinematics)


def test_a_wall_is_planned_around(walled: GlobalPlanner, ready: Pose) -> None:
    robot, kinematics = walled.robot, walled.kinematics
    start = kinematics.solve(Pose(ready.rotation, np.array((0.5, -0.3, 0.2))), robot.q_ready, max_iterations=50).q
    target = Pose(ready.rotation, np.array((0.5, 0.3, 0.2)))
    goal = kinematics.solve(target, start, max_iterations=50).q
    assert not walled.collision.edge_free(start, goal)  # the wall is in the way
    for seed in range(6):
        trajectory = walled.plan(JointState.at_rest(start), target, rng=np.random.default_rng(seed))
        assert_inside_limits(trajectory, robot)
        assert_free(trajectory, walled.collision)
        assert_arrives(trajectory, target, kinematics)


def test_a_straight_edge_is_time_optimal(planner: GlobalPlanner, robot: RobotDescription) -> None:
    # By hand: joint 7 turns by 1 rad; at 0.97 * 10 rad/s^2 half the way up, half down: 2 sqrt(1 / 9.7) = 0.642 s.
    q_goal = robot.q_ready - np.array((0, 0, 0, 0, 0, 0, 1.0))
    trajectory = planner.plan(
        JointState.at_rest(robot.q_ready), planner.kinematics.forward(q_goal), rng=np.random.default_rng(0)
    )
    assert 0.64 <= trajectory.duration <= 0.642 + 1.5 * DT


def test_an_arm_that_stands_at_the_goal_stays(planner: GlobalPlanner, robot: RobotDescription, ready: Pose) -> None:
    trajectory = planner.plan(JointState.at_rest(robot.q_ready), ready, rng=np.random.default_rng(0))
    assert len(trajectory) == 1
    np.testing.assert_array_equal(trajectory.q[0], robot.q_ready)


def test_a_plan_depends_only_on_inputs_and_generator(
    robot: RobotDescription, walled: GlobalPlanner, ready: Pose
) -> None:
    fresh = GlobalPlanner(robot, ArmKinematics(robot), CollisionModel(robot, fixtures=[WALL]), dt=DT)
    q, target = np.concatenate(((-0.6,), robot.q_ready[1:])), Pose(ready.rotation, np.array((0.5, 0.3, 0.2)))
    first = walled.plan(JointState.at_rest(q), target, rng=np.random.default_rng(3))
    second = fresh.plan(JointState.at_rest(q), target, rng=np.random.default_rng(3))
    np.testing.assert_array_equal(first.q, second.q)
    np.testing.assert_array_equal(first.ddq, second.ddq)


def test_a_hand_that_grazes_the_table_may_leave_it(planner: GlobalPlanner, ready: Pose) -> None:
    low = Pose(ready.rotation, np.array((0.5, 0.1, 0.003)))
    q = planner.kinematics.solve(low, planner.robot.q_ready, max_iterations=50).q
    assert planner.collision.in_collision(q)
    for where in ((0.5, 0.1, 0.2), (0.62, 0.1, 0.012)):  # straight up, and along the table after a retreat
        target = Pose(ready.rotation, np.array(where))
        trajectory = planner.plan(JointState.at_rest(q), target, rng=np.random.default_rng(0))
        hits = [planner.collision.in_collision(sample) for sample in trajectory.q]
        first_free = hits.index(False)
        assert not any(hits[first_free:])
        assert_inside_limits(trajectory, planner.robot)
        assert_arrives(trajectory, target, planner.kinematics)


def test_failures_name_their_reason(
    robot: RobotDescription, kinematics: ArmKinematics, planner: GlobalPlanner, ready: Pose
) -> None:
    def reason(planner: GlobalPlanner, position: tuple[float, float, float]) -> str:
        target = Pose(ready.rotation, np.array(position))
        with pytest.raises(PlanFailure) as failure:
            planner.plan(JointState.at_rest(robot.q_ready), target, rng=np.random.default_rng(0))
        assert str(failure.value).startswith(failure.value.reason)
        return failure.value.reason

    assert reason(planner, (2.0, 0.0, 0.3)) == "unreachable"
    assert reason(planner, (0.5, 0.0, -0.05)) == "goal in collision"
    block = Obstacle("block", "box", (0.4, 0.4, 0.4), Pose(np.eye(3), ready.position))
    buried = GlobalPlanner(robot, kinematics, CollisionModel(robot, fixtures=[block]), dt=DT)
    assert reason(buried, (0.3, 0.5, 0.2)) == "start in collision"


def test_a_goal_behind_closed_walls_has_no_path(
    robot: RobotDescription, kinematics: ArmKinematics, ready: Pose, monkeypatch: pytest.MonkeyPatch
) -> None:
    collision = CollisionModel(robot)
    monkeypatch.setattr(collision, "edge_free", lambda *args, **kwargs: False)
    planner = GlobalPlanner(robot, kinematics, collision, dt=DT)
    target = Pose(ready.rotation, np.array((0.5, 0.3, 0.2)))
    with pytest.raises(PlanFailure) as failure:
        planner.plan(JointState.at_rest(robot.q_ready), target, rng=np.random.default_rng(0))
    assert failure.value.reason == "no path"


@pytest.mark.parametrize("name", ["q", "dq", "ddq", "target position", "target rotation"])
def test_values_that_are_not_finite_are_refused_by_name(
    name: str, planner: GlobalPlanner, robot: RobotDescription, ready: Pose
) -> None:
    given = {
        "q": robot.q_ready,
        "dq": REST,
        "ddq": REST,
        "target position": ready.position,
        "target rotation": ready.rotation,
    }
    given[name] = np.full_like(given[name], np.nan)
    start = JointState(given["q"], given["dq"], given["ddq"])
    target = Pose(given["target rotation"], given["target position"])
    with pytest.raises(ValueError, match=f"{name} is"):
        planner.plan(start, target, rng=np.random.default_rng(0))
