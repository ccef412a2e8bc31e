from __future__ import annotations

import numpy as np
import pinocchio as pin

from dynaforge.geometry import Array, Pose
from dynaforge.planning.franka_ik import franka_configurations
from dynaforge.planning.kinematics import load_model
from dynaforge.sim.robot import RobotDescription


def last_joint(robot: RobotDescription, q: Array) -> Pose:
    """T_world_7 by Pinocchio from the URDF."""
    model, _ = load_model(robot.urdf, robot.arm_joints, robot.width_max)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return Pose(data.oMi[7].rotation.copy(), data.oMi[7].translation.copy())


def test_closed_form_agrees_with_the_urdf_and_misses_nothing(robot: RobotDescription, rng: np.random.Generator) -> None:
    for q in rng.uniform(robot.q_lower, robot.q_upper, (200, 7)):
        pose = last_joint(robot, q)
        found = franka_configurations(pose, q[6:], lower=robot.q_lower, upper=robot.q_upper)
        assert np.abs(found - q).max(axis=1).min() < 1e-6  # the configuration that the pose is from is among them
        for solution in found:
            reached = last_joint(robot, solution)
            np.testing.assert_allclose(reached.position, pose.position, atol=1e-8)
            np.testing.assert_allclose(reached.rotation, pose.rotation, atol=1e-8)
        assert ((found >= robot.q_lower) & (found <= robot.q_upper)).all()


def test_a_pose_out_of_reach_has_no_configuration(robot: RobotDescription) -> None:
    far = Pose(np.eye(3), np.array((2.0, 0.0, 0.3)))
    assert len(franka_configurations(far, np.linspace(-2.8, 2.8, 20), lower=robot.q_lower, upper=robot.q_upper)) == 0
