from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynaforge.benchmarks import limits as bench_limits
from dynaforge.geometry import JointTrajectory, Pose
from dynaforge.planning import ArmKinematics, CollisionModel, Obstacle
from dynaforge.sim.robot import franka
from dynaforge.sim.speed_limits import SpeedLimits
from dynaforge.tasks import get_task

CAN = get_task("can")


def test_the_mean_velocity_of_a_control_step_counts_too():
    robot, turn = franka(), np.eye(7)[3]
    q = robot.q_ready + np.array((0.0, 0.1, 0.1))[:, None] * turn  # 3 rad/s in the first step, and nothing said of it
    np.testing.assert_allclose(
        bench_limits.reference_shares(q, np.zeros((3, 7)), robot, dt=1 / 30), (3.0 / 2.62, 0.0), atol=1e-12
    )


def test_joint_references_of_episodes_keep_the_speed_limits_and_faster_ones_are_noticed(monkeypatch):
    (figure,) = bench_limits.speed_limits(CAN, n=1)
    assert figure.ok, figure
    assert 0.1 < figure.raw["residual 0"]["most_share"] <= 1.0 + bench_limits.ROUNDING
    assert figure.raw["random residuals"]["control_steps"] > 10
    share = SpeedLimits.share
    monkeypatch.setattr(SpeedLimits, "share", lambda limits, q, dq: share(limits, q, 3.0 * dq))
    (figure,) = bench_limits.speed_limits(CAN, n=1)
    assert not figure.ok
    assert not figure.measured.startswith("0 %")


def test_the_global_planner_is_checked_in_episodes_and_to_random_goals():
    (figure,) = bench_limits.global_planner(CAN, n=3)
    assert figure.ok, figure
    assert {name: part["outside"] for name, part in figure.raw.items()} == {
        "episodes": 0,
        "bare table": 0,
        "furnished table": 0,
    }
    assert figure.raw["episodes"]["trajectories"] >= 3


def straight(q0, q1, seconds, *, dt=0.1):
    """A joint line at constant speed, hand-worked: slopes (q1 - q0) / seconds, no acceleration."""
    n = round(seconds / dt)
    q = q0 + np.linspace(0, 1, n + 1)[:, None] * (q1 - q0)
    return JointTrajectory(dt, q, np.tile((q1 - q0) / seconds, (n + 1, 1)), np.zeros((n + 1, 7)))


def test_every_kind_of_excess_of_a_trajectory_is_noticed():
    robot = franka()
    collision, ready = CollisionModel(robot), robot.q_ready
    turn = np.eye(7)[0]
    calm = bench_limits.limit_use(straight(ready, ready + 1.31 * turn, 1.0), robot, collision)
    assert calm.inside
    assert calm.velocity == pytest.approx(0.5)  # 1.31 of 2.62 rad/s
    assert calm.position == pytest.approx(-0.8353)  # joint 4 is nearest its limit: -2.2 of -3.0353 rad
    fast = straight(ready, ready + 1.31 * turn, 0.4)
    assert bench_limits.limit_use(fast, robot, collision).velocity == pytest.approx(1.25)
    quiet = replace(fast, dq=0.0 * fast.dq)  # says that it stands still, but moves
    assert not bench_limits.limit_use(quiet, robot, collision).inside
    jump = replace(fast, dq=np.where(np.arange(5)[:, None] < 2, 0.0, 2.0 * turn))  # 2 rad/s in 0.1 s, of 10 rad/s^2
    assert bench_limits.limit_use(jump, robot, collision).acceleration == pytest.approx(2.0)
    beyond = bench_limits.limit_use(straight(ready, ready + 3.0 * turn, 3.0), robot, collision)
    assert beyond.position == pytest.approx(3.0 - 2.7415)
    down = ready + np.array((0, 1.2, 0, 0.6, 0, 0, 0))  # stretches the arm through the table
    through = bench_limits.limit_use(straight(ready, down, 3.0), robot, collision)
    assert through.collisions > 0
    assert not through.started_in_collision
    assert not through.inside


def test_a_hit_between_two_free_samples_is_noticed():
    robot = franka()
    x, y, _ = ArmKinematics(robot).forward(robot.q_ready).position
    post = Obstacle("post", "cylinder", (0.02, 2.0), Pose(np.eye(3), np.array((x, y, 1.0))))
    collision = CollisionModel(robot, fixtures=(post,))
    low, high = robot.q_ready - np.eye(7)[0], robot.q_ready + np.eye(7)[0]
    assert not collision.in_collision(low)
    assert not collision.in_collision(high)
    swing = straight(low, high, 2.0, dt=2.0)  # two samples, the post between them
    assert bench_limits.limit_use(swing, robot, collision).collisions > 0
