from __future__ import annotations

import numpy as np
import pytest

from dynaforge.geometry import JointState, Pose, matrix_from_rotvec
from dynaforge.planning import ArmKinematics, GlobalPlanner, JointReference, LocalPlanner
from dynaforge.planning.collision import CollisionModel
from dynaforge.sim import HandTarget
from dynaforge.sim.robot import RobotDescription

DT = 1 / 30


@pytest.fixture
def local(robot: RobotDescription, kinematics: ArmKinematics) -> LocalPlanner:
    return LocalPlanner(robot, kinematics, dt=DT)


def assert_step_inside_limits(before: JointReference, after: JointReference, robot: RobotDescription) -> None:
    slack = 1 + 1e-9
    lower, upper = robot.speed_limits(after.joints.q)
    assert (after.joints.dq >= lower - 1e-9).all()
    assert (after.joints.dq <= upper + 1e-9).all()
    assert (np.abs(after.joints.ddq) <= robot.ddq_max * slack).all()
    assert (np.abs(after.joints.q - before.joints.q) / DT <= robot.dq_max * slack).all()
    assert (np.abs(after.joints.dq - before.joints.dq) / DT <= robot.ddq_max * slack).all()
    assert (after.joints.q >= robot.q_lower - 1e-9).all()
    assert (after.joints.q <= robot.q_upper + 1e-9).all()
    assert abs(after.width - before.width) <= 0.1 * DT * slack


def test_references_keep_every_limit_under_jumpy_targets(
    local: LocalPlanner, robot: RobotDescription, ready: Pose, rng: np.random.Generator
) -> None:
    before, target, width = local.reset(robot.q_ready, 0.08), ready, 0.08
    for _ in range(4000):
        if rng.random() < 0.2:
            turn = matrix_from_rotvec(0.5 * rng.normal(size=3))
            target = Pose(ready.rotation @ turn, np.array((0.5, 0.0, 0.3)) + 0.3 * rng.normal(size=3))
            width = rng.uniform(-0.02, 0.1)
        after = local.track(HandTarget(target, width))
        assert_step_inside_limits(before, after, robot)
        before = after


def test_references_keep_every_limit_under_jumpy_joint_targets(
    local: LocalPlanner, robot: RobotDescription, rng: np.random.Generator
) -> None:
    before, q = local.reset(robot.q_ready, 0.08), robot.q_ready
    for _ in range(4000):
        if rng.random() < 0.2:
            q = rng.uniform(robot.q_lower - 1.0, robot.q_upper + 1.0)  # often outside the limits
        after = local.to_joints(q, 0.0)
        assert_step_inside_limits(before, after, robot)
        before = after


@pytest.mark.parametrize("dt", [1 / 15, 1 / 30, 1 / 60])
def test_every_joint_keeps_the_speed_limits_of_its_position_toward_both_ends(
    dt: float, robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    local, slowed = LocalPlanner(robot, kinematics, dt=dt), np.zeros((2, 7), bool)
    q = robot.q_ready
    for _ in range(80):
        ends = np.where(rng.random(7) < 0.5, robot.q_lower, robot.q_upper)
        aim = ends if rng.random() < 0.5 else ends + 0.3 * rng.normal(size=7)
        q = np.where(rng.random(7) < 0.4, aim, q)  # a joint that moves alone waits for no other
        for _ in range(int(rng.uniform(0.05, 1.5) / dt)):
            joints = local.to_joints(q, 0.0).joints
            lower, upper = robot.speed_limits(joints.q)
            assert (joints.dq >= lower - 1e-9).all()
            assert (joints.dq <= upper + 1e-9).all()
            near = np.stack((lower > -robot.dq_max, upper < robot.dq_max))
            slowed |= near & np.stack((joints.dq < 0.7 * lower, joints.dq > 0.7 * upper))
    assert slowed[:, 1:4].all()  # joints 2 to 4 came near the limit, in both directions


def test_a_target_that_stays_is_reached_and_held(local: LocalPlanner, robot: RobotDescription, ready: Pose) -> None:
    local.reset(robot.q_ready, 0.08)
    target = Pose(ready.rotation, ready.position + np.array((0.05, 0.03, -0.04)))
    for _ in range(60):
        reference = local.track(HandTarget(target, 0.08))
    np.testing.assert_allclose(local.kinematics.forward(reference.joints.q).position, target.position, atol=2e-4)
    np.testing.assert_allclose(reference.joints.dq, 0.0, atol=1e-9)


def test_rounding_noise_at_a_target_already_reached_is_harmless(
    local: LocalPlanner, robot: RobotDescription, rng: np.random.Generator
) -> None:
    for _ in range(500):
        q = rng.uniform(robot.q_lower, robot.q_upper)
        local.follow(JointState(q, 1e-16 * rng.normal(size=7), 1e-15 * rng.normal(size=7)), 0.08)
        np.testing.assert_allclose(local.to_joints(q, 0.08).joints.q, q, atol=1e-12)


def test_velocities_of_rounding_size_at_the_goal_end_in_rest(local: LocalPlanner, robot: RobotDescription) -> None:
    """Met in training: Ruckig answered this state with NaN, or failed."""
    q = np.array(
        (
            -0.8664270872356145,
            0.4505453167623313,
            0.7488751927752105,
            -2.548326448904159,
            -0.8156850225614529,
            2.6929260516674693,
            -2.8174346946112143,
        )
    )
    dq = np.array((1.5612511283791264e-17, 0.0, 2.591039199964395e-16, 0.0, 0.0, 3.529303922723926e-24, 0.0))
    ddq = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 1.0587911840678754e-22, 0.0))
    local.follow(JointState(q, dq, ddq), 0.08)
    for _ in range(3):
        after = local.to_joints(q, 0.08)
        np.testing.assert_array_equal(after.joints.q, q)
        assert not after.joints.dq.any()
        assert not after.joints.ddq.any()


def test_joint_targets_outside_the_limits_lead_to_the_limit(local: LocalPlanner, robot: RobotDescription) -> None:
    local.reset(robot.q_ready, 0.08)
    for _ in range(100):
        reference = local.to_joints(robot.q_ready + np.array((9.0, 0, 0, 0, 0, 0, 0)), 0.08)
    assert reference.joints.q[0] == pytest.approx(robot.q_upper[0])


def test_the_width_ramp_closes_at_a_tenth_of_a_metre_a_second(
    local: LocalPlanner, robot: RobotDescription, ready: Pose
) -> None:
    # By hand: 100 mm/s at 30 Hz is 10/3 mm a step, so 80 mm become 70 mm after three steps.
    local.reset(robot.q_ready, 0.08)
    references = [local.track(HandTarget(ready, 0.0)) for _ in range(3)]
    assert [r.width for r in references] == pytest.approx([0.08 - 0.01 / 3, 0.08 - 0.02 / 3, 0.07])
    assert [r.width_speed for r in references] == pytest.approx([-0.1, -0.1, -0.1])
    # 2 mm from the wanted width the step is 2 mm, and then the fingers rest.
    near, there = local.track(HandTarget(ready, 0.068)), local.track(HandTarget(ready, 0.068))
    assert (near.width, near.width_speed) == pytest.approx((0.068, -0.06))
    assert (there.width, there.width_speed) == pytest.approx((0.068, 0.0))


def test_the_width_never_leaves_what_the_hand_can_open(
    local: LocalPlanner, robot: RobotDescription, ready: Pose
) -> None:
    local.reset(robot.q_ready, 0.079)
    assert [local.track(HandTarget(ready, 0.5)).width for _ in range(3)] == pytest.approx([0.08] * 3)
    assert [local.track(HandTarget(ready, -0.5)).width for _ in range(40)][-1] == 0.0


def test_a_planned_trajectory_is_followed_verbatim_and_left_within_limits(
    local: LocalPlanner, robot: RobotDescription, kinematics: ArmKinematics, ready: Pose
) -> None:
    planner = GlobalPlanner(robot, kinematics, CollisionModel(robot), dt=DT)
    target = Pose(ready.rotation, ready.position + np.array((0.1, 0.25, -0.2)))
    trajectory = planner.plan(JointState.at_rest(robot.q_ready), target, rng=np.random.default_rng(0))
    before = local.reset(robot.q_ready, 0.08)
    for k in range(1, len(trajectory) // 2):
        reference = local.follow(trajectory[k], 0.04)
        np.testing.assert_array_equal(reference.joints.q, trajectory.q[k])
        np.testing.assert_array_equal(reference.joints.dq, trajectory.dq[k])
        assert_step_inside_limits(before, reference, robot)
        before = reference
    for _ in range(30):  # interrupted at full speed
        reference = local.track(HandTarget(ready, 0.04))
        assert_step_inside_limits(before, reference, robot)
        before = reference


def test_reset_forgets_what_came_before(
    local: LocalPlanner, robot: RobotDescription, kinematics: ArmKinematics, ready: Pose, rng: np.random.Generator
) -> None:
    fresh = LocalPlanner(robot, kinematics, dt=DT)
    for _ in range(7):
        local.track(HandTarget(Pose(ready.rotation, ready.position + 0.1 * rng.normal(size=3)), 0.0))
    for planner in (local, fresh):
        planner.reset(robot.q_ready, 0.08)
    target = Pose(ready.rotation, ready.position + np.array((0.1, 0.0, 0.0)))
    for _ in range(10):
        a, b = local.track(HandTarget(target, 0.05)), fresh.track(HandTarget(target, 0.05))
        np.testing.assert_array_equal(a.joints.q, b.joints.q)
        assert a.width == b.width


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused_and_change_nothing(
    bad: float, local: LocalPlanner, robot: RobotDescription, ready: Pose
) -> None:
    before = local.reset(robot.q_ready, 0.08)
    q = robot.q_ready.copy()
    q[2] = bad
    zeros = np.zeros(7)
    with pytest.raises(ValueError, match="Target position"):
        local.track(HandTarget(Pose(ready.rotation, np.array((bad, 0.0, 0.0))), 0.04))
    with pytest.raises(ValueError, match="width is"):
        local.track(HandTarget(ready, bad))
    with pytest.raises(ValueError, match="q_target is"):
        local.to_joints(q, 0.04)
    with pytest.raises(ValueError, match="ddq is"):
        local.follow(JointState(zeros, zeros, q), 0.04)
    with pytest.raises(ValueError, match="q is"):
        local.reset(q, 0.04)
    assert local.reference is before
    np.testing.assert_allclose(local.track(HandTarget(ready, 0.08)).joints.q, robot.q_ready)
