from __future__ import annotations

import numpy as np
import pytest

from dynaforge.geometry import Array, JointTrajectory
from dynaforge.planning import timing
from dynaforge.planning.timing import Line, PathTimer, Spline, join
from dynaforge.sim.robot import RobotDescription

DT = 1 / 30


@pytest.fixture
def timer(robot: RobotDescription) -> PathTimer:
    return PathTimer(robot, dt=DT)


def zigzag(rng: np.random.Generator) -> Array:
    return rng.uniform(-1.0, 1.0, (5, 7))


def test_sampled_derivatives_are_those_of_the_sampled_positions(timer: PathTimer, robot: RobotDescription) -> None:
    # A straight edge is ramped up and down: in the first third each step has one acceleration.
    for share in np.linspace(0.2, 1.0, 15):
        trajectory = timer.time(Line(robot.q_ready, robot.q_ready + share))
        assert trajectory is not None
        for k in range(len(trajectory) // 3):
            dq, ddq = trajectory.dq[k], trajectory.ddq[k]
            np.testing.assert_allclose(trajectory.dq[k + 1], dq + DT * ddq, atol=1e-5)
            np.testing.assert_allclose(
                trajectory.q[k + 1], trajectory.q[k] + DT * dq + 0.5 * DT * DT * ddq, rtol=0, atol=1e-5
            )


def test_no_sample_of_a_sharp_spline_exceeds_a_limit_between_coarse_grid_points(
    timer: PathTimer, robot: RobotDescription, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(timing, "SPLINE_GRID", 2)  # TOPP-RA alone would exceed the limits between these
    for seed in range(30):
        trajectory = timer.time(Spline(zigzag(np.random.default_rng(seed))))
        assert trajectory is not None
        assert (np.abs(trajectory.dq) <= robot.dq_max).all()
        assert (np.abs(trajectory.ddq) <= robot.ddq_max).all()


def test_a_spline_passes_through_its_waypoints(rng: np.random.Generator) -> None:
    waypoints = zigzag(rng)
    spline = Spline(waypoints)
    lengths = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    np.testing.assert_allclose(spline(np.concatenate(((0.0,), np.cumsum(lengths)))), waypoints, atol=1e-12)


def test_joined_trajectories_share_the_sample_where_they_meet() -> None:
    def ramp(start: float, n: int) -> JointTrajectory:
        q = np.repeat(start + np.arange(n)[:, None], 7, axis=1)
        return JointTrajectory(DT, q, np.zeros_like(q), np.zeros_like(q))

    joined = join([ramp(0.0, 3), ramp(2.0, 4)])
    np.testing.assert_array_equal(joined.q[:, 0], np.arange(6))
    assert len(joined.dq) == len(joined.ddq) == 6
