from __future__ import annotations

import numpy as np
import pytest

from dynaforge.geometry import JointState, Pose, matrix_from_rotvec
from dynaforge.planning import (
    ArmKinematics,
    CollisionModel,
    GlobalPlanner,
    JointReference,
    LocalPlanner,
    TargetFollower,
)
from dynaforge.planning.target_follower import LIMIT_TOLERANCE, stopping_velocity
from dynaforge.sim import HandTarget
from dynaforge.sim.robot import ELBOW, RobotDescription

DT = 1 / 30


@pytest.fixture
def follower(robot: RobotDescription, kinematics: ArmKinematics) -> TargetFollower:
    return TargetFollower(robot, kinematics, dt=DT)


def motions(robot: RobotDescription, kinematics: ArmKinematics, ready: Pose) -> list[JointReference]:
    """References of both planners of the prior: a global plan, then targets that jump, all inside the limits."""
    local = LocalPlanner(robot, kinematics, dt=DT)
    planner = GlobalPlanner(robot, kinematics, CollisionModel(robot), dt=DT)
    goal = Pose(ready.rotation @ matrix_from_rotvec((0.0, 0.0, 0.8)), ready.position + np.array((0.1, 0.25, -0.2)))
    plan = planner.plan(JointState.at_rest(robot.q_ready), goal, rng=np.random.default_rng(0))
    local.reset(robot.q_ready, 0.08)
    references = [local.follow(plan[k], 0.04) for k in range(1, len(plan))]
    rng = np.random.default_rng(1)
    for _ in range(12):
        turn = matrix_from_rotvec(0.3 * rng.normal(size=3))
        target = Pose(ready.rotation @ turn, np.array((0.5, 0.0, 0.3)) + 0.1 * rng.normal(size=3))
        references += [local.track(HandTarget(target, rng.uniform(0.0, 0.08))) for _ in range(10)]
    return references


def assert_step_inside_limits(before: JointReference, after: JointReference, robot: RobotDescription) -> None:
    slack = 1 + LIMIT_TOLERANCE + 1e-9
    lower, upper = robot.speed_limits((before.joints.q + after.joints.q) / 2)
    rounding = 1.2 * LIMIT_TOLERANCE * robot.dq_max  # which itself moves the middle of the step
    assert (after.joints.dq >= lower - rounding).all()
    assert (after.joints.dq <= upper + rounding).all()
    assert (np.abs(after.joints.dq - before.joints.dq) / DT <= robot.ddq_max * slack).all()
    np.testing.assert_allclose(after.joints.dq, (after.joints.q - before.joints.q) / DT, atol=1e-9)
    assert (after.joints.q >= robot.q_lower - 1e-9).all()
    assert (after.joints.q <= robot.q_upper + 1e-9).all()
    assert abs(after.width - before.width) <= 0.1 * DT * slack


def test_a_joint_stream_that_the_limits_allow_is_met_exactly(
    follower: TargetFollower, robot: RobotDescription, kinematics: ArmKinematics, ready: Pose
) -> None:
    for wanted in motions(robot, kinematics, ready):
        target = wanted.joints.q.astype(np.float32).astype(np.float64)
        reached = follower.reach_joints(target, wanted.width)
        np.testing.assert_array_equal(reached.joints.q, np.clip(target, robot.q_lower, robot.q_upper))
        assert reached.width == pytest.approx(wanted.width, abs=1e-12)


def test_a_stream_of_poses_and_elbows_that_the_limits_allow_is_met_exactly(
    follower: TargetFollower, robot: RobotDescription, kinematics: ArmKinematics, ready: Pose
) -> None:
    for wanted in motions(robot, kinematics, ready):
        reached = follower.reach(
            HandTarget(kinematics.forward(wanted.joints.q), wanted.width), elbow=wanted.joints.q[ELBOW]
        )
        np.testing.assert_allclose(reached.joints.q, wanted.joints.q, atol=5e-5)
        error = kinematics.forward(reached.joints.q).position - kinematics.forward(wanted.joints.q).position
        assert np.linalg.norm(error) <= 2e-6


def test_a_pose_alone_is_reached_with_the_elbow_where_it_is_handy(
    follower: TargetFollower, robot: RobotDescription, kinematics: ArmKinematics, ready: Pose
) -> None:
    for k in range(40):  # a slow circle
        angle = 0.05 * k
        offset = 0.03 * np.array((np.cos(angle) - 1.0, np.sin(angle), 0.0))
        reached = follower.reach(HandTarget(Pose(ready.rotation, ready.position + offset), 0.08))
        np.testing.assert_allclose(kinematics.forward(reached.joints.q).position, ready.position + offset, atol=2e-6)
    assert np.abs(reached.joints.q - robot.q_ready).max() < 0.2


def test_two_elbows_hold_the_hand_at_one_pose(
    follower: TargetFollower, kinematics: ArmKinematics, robot: RobotDescription, ready: Pose
) -> None:
    for elbow in (0.3, -0.3):
        for _ in range(40):
            reached = follower.reach(HandTarget(ready, 0.08), elbow=elbow)
        assert reached.joints.q[ELBOW] == pytest.approx(elbow, abs=1e-4)
        np.testing.assert_allclose(kinematics.forward(reached.joints.q).position, ready.position, atol=2e-6)


@pytest.mark.parametrize("kind", ["joints", "poses"])
def test_every_limit_holds_under_jumpy_targets(
    kind: str, follower: TargetFollower, robot: RobotDescription, ready: Pose, rng: np.random.Generator
) -> None:
    before, target, q, width = follower.reset(robot.q_ready, 0.08), ready, robot.q_ready, 0.08
    for _ in range(2000):
        if rng.random() < 0.2:
            turn = matrix_from_rotvec(0.5 * rng.normal(size=3))
            target = Pose(ready.rotation @ turn, np.array((0.5, 0.0, 0.3)) + 0.3 * rng.normal(size=3))
            q = rng.uniform(robot.q_lower - 1.0, robot.q_upper + 1.0)  # often outside the limits
            width = rng.uniform(-0.02, 0.1)
        elbow = rng.uniform(-3.0, 3.0) if rng.random() < 0.3 else None
        after = (
            follower.reach_joints(q, width)
            if kind == "joints"
            else follower.reach(HandTarget(target, width), elbow=elbow)
        )
        assert_step_inside_limits(before, after, robot)
        before = after


def test_a_target_far_off_is_reached_on_the_straight_line_in_the_least_time_without_overshoot(
    follower: TargetFollower, robot: RobotDescription
) -> None:
    goal = robot.q_ready + np.array((0.5, 0.2, -0.1, 0.3, 0.0, -0.2, 0.4))
    follower.reset(robot.q_ready, 0.08)
    path = [follower.reach_joints(goal, 0.08).joints.q for _ in range(24)]
    shares = (np.array(path) - robot.q_ready)[:, [0, 1, 2, 3, 5, 6]] / (goal - robot.q_ready)[[0, 1, 2, 3, 5, 6]]
    np.testing.assert_allclose(shares, np.broadcast_to(shares[:, :1], shares.shape), atol=1e-9)  # all joints together
    assert (np.diff(shares[:, 0]) >= -1e-12).all()
    assert shares.max() <= 1.0 + 1e-12
    # By hand: half a radian at 10 rad/s^2, half of it speeding up, takes 2 sqrt(0.5 / 10) = 0.447 s: 13.4 steps.
    first = int(np.flatnonzero(np.abs(shares[:, 0] - 1.0) < 1e-9)[0]) + 1
    assert first <= 15
    np.testing.assert_allclose(follower.reach_joints(goal, 0.08).joints.dq, 0.0, atol=1e-12)


def test_a_target_that_moves_on_steadily_is_caught_up_and_then_met_exactly(
    follower: TargetFollower, robot: RobotDescription
) -> None:
    start = robot.q_ready + np.array((0.3, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0))
    speed = np.array((0.8, -0.3, 0.0, 0.2, 0.5, 0.0, -0.4))
    follower.reset(robot.q_ready, 0.08)
    behind = [
        follower.reach_joints(start + k * DT * speed, 0.08).joints.q - (start + k * DT * speed) for k in range(60)
    ]
    late = np.abs(behind).max(axis=1)
    np.testing.assert_allclose(late[30:], 0.0, atol=1e-12)


def test_the_stopping_velocity_stops_within_the_distance_and_no_sooner_than_it_must() -> None:
    # By hand, gain 1 rad/s a step of 1 s: 3 + 2 + 1 = 6 rad; from 6.5 rad, four steps of 3.125, 2.125, 1.125, 0.125.
    distances = np.array((0.0, 0.4, 1.0, 3.0, 6.0, 6.5, 10.0))
    wanted = (0.0, 0.4, 1.0, 2.0, 3.0, 3.125, 4.0)
    np.testing.assert_allclose(stopping_velocity(distances, 1.0, 1.0), wanted)
    for velocity, distance in zip(wanted, distances, strict=True):
        steps = np.arange(velocity, 0.0, -1.0)
        assert steps.sum() == pytest.approx(distance)


def test_reset_forgets_what_came_before(
    follower: TargetFollower, robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    for _ in range(7):
        follower.reach_joints(rng.uniform(robot.q_lower, robot.q_upper), 0.0)
    follower.reset(robot.q_ready, 0.08)
    fresh = TargetFollower(robot, kinematics, dt=DT)
    for _ in range(10):
        a, b = (f.reach_joints(robot.q_ready + 0.2, 0.05) for f in (follower, fresh))
        np.testing.assert_array_equal(a.joints.q, b.joints.q)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused_and_change_nothing(
    bad: float, follower: TargetFollower, robot: RobotDescription, ready: Pose
) -> None:
    before = follower.reset(robot.q_ready, 0.08)
    q = robot.q_ready.copy()
    q[2] = bad
    with pytest.raises(ValueError, match="Target position"):
        follower.reach(HandTarget(Pose(ready.rotation, np.array((bad, 0.0, 0.0))), 0.04))
    with pytest.raises(ValueError, match="elbow is"):
        follower.reach(HandTarget(ready, 0.04), elbow=bad)
    with pytest.raises(ValueError, match="width is"):
        follower.reach(HandTarget(ready, bad))
    with pytest.raises(ValueError, match="q_target is"):
        follower.reach_joints(q, 0.04)
    assert follower.reference is before
    np.testing.assert_array_equal(follower.reach_joints(robot.q_ready, 0.08).joints.q, robot.q_ready)
