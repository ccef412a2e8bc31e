"""Eq. 5 by itself: a = project(a_plan + m * scale * a_res)."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dynaforge.envs.executor import PlannedAction
from dynaforge.envs.residual import ResidualScale, gated, project, requested_target
from dynaforge.geometry import JointState, Pose, matrix_from_rotvec
from dynaforge.planning import ArmKinematics, LocalPlanner
from dynaforge.sim import HandTarget, franka
from dynaforge.tasks import FRAMES, ResidualSpec
from dynaforge.tasks.targets import DOWN_ALONG_X

SPEC = ResidualSpec(translation=(0.15, 0.0, 0.06), rotation=(0.0, 0.0, 0.2))
PLAN = PlannedAction(HandTarget(Pose(DOWN_ALONG_X, np.array((0.5, 0.1, 0.2))), 0.06), True, 1, None)
RESIDUAL = np.array((0.01, -0.02, 0.03, 0.1, -0.2, 0.3, -0.04))


def running(share: float = 0.5) -> Any:
    """A phase that takes a share of the scales, its object heading anywhere."""
    frame = Pose(matrix_from_rotvec((0.0, 0.0, 1.1)), np.zeros(3))
    return SimpleNamespace(phase=SimpleNamespace(residual_share=share), frame=frame)


@pytest.fixture
def local() -> LocalPlanner:
    robot = franka()
    return LocalPlanner(robot, ArmKinematics(robot), dt=1 / 30)


@pytest.mark.parametrize("frame", FRAMES)
def test_an_action_is_scaled_by_the_share_and_turned_into_the_world(frame: str) -> None:
    scale, now = ResidualScale(replace(SPEC, frame=frame)), running()
    assert scale.size == 4, "dimensions of scale 0 have no number"
    residual = scale.physical(np.array((1.0, -1.0, 0.5, -0.5)), now)
    turn = now.frame.rotation if frame == "target" else np.eye(3)
    np.testing.assert_allclose(turn.T @ residual[:3], (0.075, 0.0, -0.03), atol=1e-15)
    np.testing.assert_allclose(turn.T @ residual[3:6], (0.0, 0.0, 0.05), atol=1e-15)
    assert residual[6] == -0.5 * 0.5 * 0.02


@pytest.mark.parametrize("frame", FRAMES)
def test_a_residual_tells_its_action_and_an_impossible_one_the_nearest(frame: str) -> None:
    scale, now, rng = ResidualScale(replace(SPEC, frame=frame)), running(), np.random.default_rng(0)
    for size in np.logspace(-9, 0, 50):
        action = scale.read(rng.uniform(-size, size, scale.size))
        assert scale.nearest_action(scale.physical(action, now), now).tobytes() == action.tobytes()
    most = np.array((1.0, -1.0, 1.0, -1.0))
    np.testing.assert_array_equal(scale.nearest_action(3.0 * scale.physical(most, now), now), most)


def test_a_closed_gate_leaves_the_plan_as_it_is_and_an_open_one_lets_the_residual_act() -> None:
    closed = replace(PLAN, gate=False)
    assert gated(RESIDUAL, closed) is None
    assert requested_target(closed, gated(RESIDUAL, closed)) is PLAN.target
    assert requested_target(PLAN, gated(None, PLAN)) is PLAN.target
    requested = requested_target(PLAN, gated(RESIDUAL, PLAN))
    np.testing.assert_array_equal(requested.flat(), PLAN.target.corrected(RESIDUAL).flat())


def test_the_projection_keeps_the_limits_and_follows_a_sample_of_a_plan_as_it_is(local: LocalPlanner) -> None:
    robot, before = local.robot, local.reference
    wild = HandTarget(Pose(DOWN_ALONG_X, np.array((0.5, 0.1, -0.5))), 3.0)
    after = project(wild, PLAN, local)
    assert (np.abs(after.joints.q - before.joints.q) <= robot.dq_max / 30 * (1 + 1e-9)).all()
    assert 0.0 <= after.width <= robot.width_max
    sample = JointState.at_rest(robot.q_ready + 0.01)
    planned = replace(PLAN, gate=False, sample=sample)
    assert project(planned.target, planned, local).joints is sample
