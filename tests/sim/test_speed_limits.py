from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynaforge.sim.robot import franka

ROBOT = franka()
LIMITS = ROBOT.speed_limits


def test_the_speed_limits_are_those_of_the_franka_research_3():
    # By hand from the FCI documentation: joint 1 half a radian from its end, -0.3 + sqrt(12 * 0.5); joint 4 a tenth
    # above its lower end, 0.3 - sqrt(8 * 0.1); joint 6 a tenth above 0.54092, 0.35 - sqrt(11 * 0.1).
    lower, upper = LIMITS(np.array((2.2501, 0.0, 0.0, -2.9481, 0.0, 0.64092, 0.0)))
    assert upper[0] == pytest.approx(-0.3 + np.sqrt(6.0))
    assert lower[3] == pytest.approx(0.3 - np.sqrt(0.8))
    assert lower[5] == pytest.approx(0.35 - np.sqrt(1.1))
    assert (lower[0], upper[3], lower[4], upper[5]) == (-2.62, 2.62, -5.26, 4.18)


def test_a_joint_at_its_end_may_only_leave_it():
    beyond = LIMITS.upper + 0.1
    lower, upper = LIMITS(np.stack((beyond, LIMITS.upper, LIMITS.lower - 0.1)))
    assert not upper[:2].any()
    assert not lower[2].any()
    np.testing.assert_array_equal(lower[0], -LIMITS.cap)
    np.testing.assert_array_equal(upper[2], LIMITS.cap)


def test_each_side_counts_by_its_own_limit():
    near_lower_end = np.array((0.0, 0.0, 0.0, -2.9481, 0.0, 2.2, 0.785))  # a tenth above: joint 4 may go down at 0.594
    down_and_up = np.array((-0.6, 0.6))[:, None] * np.eye(7)[3]
    shares = LIMITS.share(np.stack((near_lower_end, near_lower_end)), down_and_up)
    np.testing.assert_allclose(shares, (0.6 / (np.sqrt(0.8) - 0.3), 0.6 / 2.62))
    assert LIMITS.share(LIMITS.upper, np.eye(7)[0]) > 1e6
    assert LIMITS.share(LIMITS.upper, np.zeros(7)) == 0.0


def test_one_configuration_and_many_have_the_same_limits():
    q = np.random.default_rng(0).uniform(LIMITS.lower - 0.1, LIMITS.upper + 0.1, (3, 5, 7))
    many = LIMITS(q)
    for index in np.ndindex(3, 5):
        for one, rows in zip(LIMITS(q[index]), many, strict=True):
            np.testing.assert_array_equal(one, rows[index])


def test_limits_ahead_allow_the_speed_that_is_still_allowed_where_it_leads():
    seconds = 0.04
    q = np.random.default_rng(0).uniform(LIMITS.lower, LIMITS.upper, (2000, 7))
    lower, upper = LIMITS.ahead(seconds)(q)
    np.testing.assert_allclose(LIMITS(q + seconds * upper)[1], upper, atol=1e-12)
    np.testing.assert_allclose(LIMITS(q + seconds * lower)[0], lower, atol=1e-12)


def test_a_joint_that_can_stop_before_its_position_limit_can_keep_the_speed_limits():
    """Along each limit, or along the braking parabola that ends at the position limit, where it is lower."""
    q = np.linspace(ROBOT.q_lower, ROBOT.q_upper, 20_001)
    stopping = np.sqrt(2.0 * ROBOT.ddq_max * (ROBOT.q_upper - q)), np.sqrt(2.0 * ROBOT.ddq_max * (q - ROBOT.q_lower))
    for speeds in (np.minimum(LIMITS(q)[1], stopping[0]), np.minimum(-LIMITS(q)[0], stopping[1])):
        braking = 0.5 * np.abs(np.diff(speeds**2, axis=0)) / np.diff(q, axis=0)
        assert (braking <= ROBOT.ddq_max * (1.0 + 1e-9)).all()


def test_limits_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match=r"gain is .*; all seven must be above 0"):
        replace(LIMITS, gain=np.zeros(7))
    with pytest.raises(ValueError, match="lower is not below upper"):
        replace(LIMITS, lower=LIMITS.upper)
    with pytest.raises(ValueError, match="seconds is -1"):
        LIMITS.ahead(-1.0)
    with pytest.raises(ValueError, match="cannot get to q_lower and q_upper within speed_limits"):
        replace(ROBOT, q_upper=ROBOT.q_upper + 0.1)
