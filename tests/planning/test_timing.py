from __future__ import annotations

import numpy as np
import pytest
from toppra.constraint import JointTorqueConstraint

from dynaforge.geometry import Array, JointTrajectory
from dynaforge.planning import timing
from dynaforge.planning.timing import Line, PathTimer, Spline, join
from dynaforge.sim.arm_dynamics import ArmDynamics
from dynaforge.sim.robot import RobotDescription

DT = 1 / 30
LAST = np.eye(7)[6]  # a change of the last joint alone


@pytest.fixture
def timer(robot: RobotDescription) -> PathTimer:
    return PathTimer(robot, dt=DT)


def zigzag(rng: np.random.Generator) -> Array:
    return rng.uniform(-1.0, 1.0, (5, 7))


def test_sampled_derivatives_are_those_of_the_sampled_positions(timer: PathTimer, robot: RobotDescription) -> None:
    # The last joint is ramped up and down, far from its torque limit: the first third has one acceleration.
    for share in np.linspace(0.2, 1.0, 15):
        trajectory = timer.time(Line(robot.q_ready, robot.q_ready + share * LAST))
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
    monkeypatch.setattr(timing, "SPLINE_GRID", 4)  # TOPP-RA alone would exceed the limits between these
    for seed in range(30):
        trajectory = timer.time(Spline(robot.q_ready + 0.4 * zigzag(np.random.default_rng(seed))))
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


def random_edges(robot: RobotDescription, n: int) -> list[Line]:
    rng = np.random.default_rng(5)
    ends = rng.uniform(robot.q_lower + 0.02, robot.q_upper - 0.02, (n, 2, 7))
    return [Line(a, a + share * (b - a)) for (a, b), share in zip(ends, rng.uniform(0.05, 1.0, n), strict=True)]


def toppra_seconds(robot: RobotDescription, line: Line) -> float:
    """Time an edge by TOPP-RA under the same limits: speeds by position, accelerations and torques."""
    dynamics, still = ArmDynamics(robot), np.zeros(7)
    torque = timing.TORQUE_SHARE * robot.effort_max

    def inverse_dynamics(q: Array, dq: Array, ddq: Array) -> Array:
        return dynamics.torque(q, dq, ddq)

    def speeds(s: float) -> Array:
        return timing.LIMIT_SHARE * np.stack(robot.speed_limits(line(s)), axis=1)

    scheme = {"discretization_scheme": timing.DiscretizationType.Interpolation}
    most = timing.LIMIT_SHARE * robot.ddq_max
    constraints = [
        timing.JointVelocityConstraintVarying(speeds),
        timing.JointAccelerationConstraint(np.stack((-most, most), axis=1), **scheme),
        JointTorqueConstraint(inverse_dynamics, np.stack((-torque, torque), axis=1), still, **scheme),
    ]
    grid = np.linspace(0.0, 1.0, 201)
    solved = timing.TOPPRA(constraints, line, gridpoints=grid, solver_wrapper="seidel").compute_parameterization(0, 0)
    return float(np.sum(2.0 * np.diff(grid) / (solved[1][1:] + solved[1][:-1])))


def test_a_straight_edge_is_as_fast_as_toppra_finds_it(timer: PathTimer, robot: RobotDescription) -> None:
    ratios = []
    for line in random_edges(robot, 40):
        trajectory = timer.time(line)
        assert trajectory is not None
        ratios.append((trajectory.duration - DT) / toppra_seconds(robot, line))  # at most one sample is rounding
    assert np.quantile(ratios, 0.9) < 1.02
    assert max(ratios) < 1.1


def test_every_sample_of_a_straight_edge_keeps_speeds_accelerations_and_torques(
    timer: PathTimer, robot: RobotDescription
) -> None:
    dynamics, torque_share = ArmDynamics(robot), 0.0
    for line in random_edges(robot, 100):
        trajectory = timer.time(line)
        assert trajectory is not None
        lower, upper = robot.speed_limits(trajectory.q)
        assert ((trajectory.dq >= lower) & (trajectory.dq <= upper)).all()
        assert (np.abs(trajectory.ddq) <= robot.ddq_max).all()
        weight, torque = dynamics.torques(trajectory)
        assert (np.abs(torque) <= np.maximum(0.86 * robot.effort_max, np.abs(weight) + 0.06 * robot.effort_max)).all()
        torque_share = max(torque_share, float((np.abs(torque) / robot.effort_max).max()))
        np.testing.assert_array_equal(trajectory.q[[0, -1]], line(np.array((0.0, 1.0))))
        assert not trajectory.dq[[0, -1]].any()
    assert torque_share > 0.8  # the torque limit binds somewhere
