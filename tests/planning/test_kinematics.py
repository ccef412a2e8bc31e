from __future__ import annotations

import numpy as np
import pybullet as p
import pytest
from pybullet_utils.bullet_client import BulletClient

from dynaforge.geometry import Array, Pose, matrix_from_quat, matrix_from_rotvec, rotvec_from_matrix
from dynaforge.planning import ArmKinematics
from dynaforge.sim.robot import RobotDescription


def random_q(robot: RobotDescription, rng: np.random.Generator) -> Array:
    return rng.uniform(robot.q_lower, robot.q_upper)


def near_ready(robot: RobotDescription, rng: np.random.Generator) -> Array:
    return np.clip(robot.q_ready + rng.uniform(-0.4, 0.4, 7), robot.q_lower, robot.q_upper)


def test_forward_kinematics_agree_with_physics(
    robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    client = BulletClient(connection_mode=p.DIRECT)
    try:
        arm = client.loadURDF(str(robot.urdf), useFixedBase=True, flags=p.URDF_IGNORE_VISUAL_SHAPES)
        infos = [client.getJointInfo(arm, i) for i in range(client.getNumJoints(arm))]
        joints = {info[1].decode(): info[0] for info in infos}
        links = {info[12].decode(): info[0] for info in infos}
        for _ in range(50):
            q = random_q(robot, rng)
            for name, value in zip(robot.arm_joints, q.tolist(), strict=True):
                client.resetJointState(arm, joints[name], value)
            state = client.getLinkState(arm, links[robot.ee_link], computeForwardKinematics=1)
            x, y, z, w = state[5]
            ee = kinematics.forward(q)
            np.testing.assert_allclose(ee.position, state[4], atol=1e-6)
            np.testing.assert_allclose(ee.rotation, matrix_from_quat((w, x, y, z)), atol=1e-6)
    finally:
        client.disconnect()


def test_forward_returns_poses_that_later_calls_leave_alone(robot: RobotDescription, kinematics: ArmKinematics) -> None:
    pose = kinematics.forward(robot.q_ready)
    before = pose.position.copy(), pose.rotation.copy()
    kinematics.forward(robot.q_ready + 0.3)
    np.testing.assert_array_equal(pose.position, before[0])
    np.testing.assert_array_equal(pose.rotation, before[1])


def test_jacobian_is_the_derivative_of_forward_kinematics_in_world_axes(
    robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    h = 1e-6
    for _ in range(10):
        q = random_q(robot, rng)
        numeric = np.empty((6, 7))
        for j, step in enumerate(h * np.eye(7)):
            before, after = kinematics.forward(q - step), kinematics.forward(q + step)
            numeric[:3, j] = (after.position - before.position) / (2 * h)
            numeric[3:, j] = rotvec_from_matrix(after.rotation @ before.rotation.T) / (2 * h)
        np.testing.assert_allclose(kinematics.jacobian(q), numeric, atol=1e-7)


def test_three_iterations_follow_a_jump_of_five_centimetres(
    robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    for _ in range(100):
        q = near_ready(robot, rng)
        here, jump = kinematics.forward(q), rng.normal(size=3)
        turn = matrix_from_rotvec(0.05 * rng.normal(size=3))
        target = Pose(here.rotation @ turn, here.position + 0.05 * jump / np.linalg.norm(jump))
        result = kinematics.solve(target, q)
        reached = kinematics.forward(result.q)
        assert result.converged
        assert np.linalg.norm(reached.position - target.position) <= 1e-4
        assert np.linalg.norm(rotvec_from_matrix(reached.rotation.T @ target.rotation)) <= 1e-3


def test_reported_errors_are_those_of_the_returned_configuration(
    robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    for _ in range(50):
        target = kinematics.forward(random_q(robot, rng))
        result = kinematics.solve(target, random_q(robot, rng))
        reached = kinematics.forward(result.q)
        assert result.position_error == pytest.approx(np.linalg.norm(reached.position - target.position), abs=1e-9)
        angle = np.linalg.norm(rotvec_from_matrix(reached.rotation.T @ target.rotation))
        assert result.rotation_error == pytest.approx(angle, abs=1e-6)


def test_solutions_stay_inside_the_limits_wherever_the_target_is(
    robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    for iterations in (1, 3, 30):
        for _ in range(100):
            target = Pose(matrix_from_rotvec(2.0 * rng.normal(size=3)), rng.normal(size=3))
            seed = robot.q_ready + rng.normal(size=7) * 3.0  # often outside
            q = kinematics.solve(target, seed, max_iterations=iterations).q
            assert (q >= robot.q_lower).all()
            assert (q <= robot.q_upper).all()


def test_a_target_out_of_reach_is_never_answered_by_something_worse_than_the_seed(
    robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    for _ in range(50):
        q = near_ready(robot, rng)
        target = Pose(kinematics.forward(q).rotation, 2.0 * rng.normal(size=3))
        seed = kinematics.solve(target, q, max_iterations=0)
        result = kinematics.solve(target, q)
        assert result.position_error + result.rotation_error <= seed.position_error + seed.rotation_error


def test_the_null_space_pull_leads_toward_the_ready_pose(robot: RobotDescription, kinematics: ArmKinematics) -> None:
    # The elbow is swivelled while the hand stays; small moves of the hand then bring the elbow back.
    ready = kinematics.forward(robot.q_ready)
    q = swivelled = kinematics.solve(ready, robot.q_ready + np.array((0.5, 0, -0.5, 0, 0, 0, 0)), max_iterations=50).q
    for k in range(100):
        shift = np.array((0.01 * (k % 2), 0.0, 0.0))
        q = kinematics.solve(Pose(ready.rotation, ready.position + shift), q).q
    assert np.linalg.norm(q - robot.q_ready) < 0.5 * np.linalg.norm(swivelled - robot.q_ready)


def test_cold_search_finds_a_solution_that_is_valid(
    robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    for _ in range(20):
        target = kinematics.forward(near_ready(robot, rng))
        result = kinematics.solve_cold(target, q_seed=random_q(robot, rng), valid=lambda q: q[0] > 0.0)
        assert result.converged
        assert result.q[0] > 0.0


def test_cold_search_reports_a_refused_solution_as_converged(
    robot: RobotDescription, kinematics: ArmKinematics, ready: Pose
) -> None:
    result = kinematics.solve_cold(ready, q_seed=robot.q_ready, valid=lambda q: False)
    assert result.converged
    np.testing.assert_array_equal(result.q, robot.q_ready)  # the first one met


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_targets_that_are_not_finite_are_refused(
    bad: float, robot: RobotDescription, kinematics: ArmKinematics, ready: Pose
) -> None:
    for entry in range(12):
        position, rotation = ready.position.copy(), ready.rotation.copy()
        (position if entry < 3 else rotation.reshape(-1))[entry - 3 if entry >= 3 else entry] = bad
        with pytest.raises(ValueError, match="must be finite"):
            kinematics.solve(Pose(rotation, position), robot.q_ready)


def test_cold_search_without_a_step_from_the_seed_finds_the_pose_in_closed_form(
    robot: RobotDescription, kinematics: ArmKinematics, rng: np.random.Generator
) -> None:
    for _ in range(20):
        target = kinematics.forward(near_ready(robot, rng))
        found, refused = (
            kinematics.solve_cold(target, q_seed=robot.q_ready, valid=valid, max_iterations=0)
            for valid in (lambda q: True, lambda q: False)
        )
        assert found.converged
        assert refused.converged  # in reach, though in collision: so says the reason of a failed plan
        again = kinematics.solve_cold(target, q_seed=robot.q_ready, max_iterations=0)
        np.testing.assert_array_equal(found.q, again.q)
