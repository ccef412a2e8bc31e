from __future__ import annotations

import numpy as np
import pytest

from dynaforge.geometry import Pose
from dynaforge.planning import ArmKinematics, CollisionModel
from dynaforge.sim.robot import RobotDescription, franka


@pytest.fixture(scope="session")
def robot() -> RobotDescription:
    return franka()


@pytest.fixture(scope="session")
def kinematics(robot: RobotDescription) -> ArmKinematics:
    return ArmKinematics(robot)


@pytest.fixture(scope="session")
def collision(robot: RobotDescription) -> CollisionModel:
    return CollisionModel(robot)


@pytest.fixture(scope="session")
def ready(robot: RobotDescription, kinematics: ArmKinematics) -> Pose:
    """T_world_ee at the ready pose: the hand points down."""
    return kinematics.forward(robot.q_ready)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)
