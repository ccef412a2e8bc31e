from __future__ import annotations

import numpy as np
import pytest

from dynaforge.geometry import Pose, matrix_from_quat, matrix_from_rotvec
from dynaforge.sim import HandTarget, franka
from dynaforge.sim.hand_target import CLEARANCE, HAND_POINTS

ROTATION = matrix_from_rotvec((2.0, 0.5, 0.3))
TARGET = HandTarget(Pose(ROTATION, np.array((0.4, -0.1, 0.3))), 0.05)


def test_a_residual_moves_the_hand_turns_it_in_place_and_changes_its_opening() -> None:
    turn = np.array((0.1, -0.2, 0.3))
    corrected = TARGET.corrected(np.array((0.01, -0.02, 0.03, *turn, -0.004)))
    np.testing.assert_allclose(corrected.pose.position, (0.41, -0.12, 0.33), atol=1e-15)
    np.testing.assert_allclose(corrected.pose.rotation, matrix_from_rotvec(turn) @ ROTATION, atol=1e-15)
    assert corrected.width == pytest.approx(0.046)


def test_a_residual_without_rotation_leaves_every_bit_of_the_rotation() -> None:
    assert TARGET.corrected(np.array((0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))).pose.rotation is ROTATION


@pytest.mark.parametrize(("asked", "given"), [(-0.02, 0.0), (0.03, 0.03), (0.2, 0.08)])
def test_the_hand_stays_above_the_table_and_opens_no_further_than_it_can(asked: float, given: float) -> None:
    low = HandTarget(Pose(ROTATION, np.array((0.4, -0.1, -0.2))), asked).within_reach(franka())
    np.testing.assert_array_equal(low.pose.position[:2], (0.4, -0.1))
    assert low.pose.apply(HAND_POINTS)[:, 2].min() == pytest.approx(CLEARANCE)
    assert low.pose.rotation is ROTATION
    assert low.width == given
    assert TARGET.within_reach(franka()).pose is TARGET.pose


def test_the_hand_stays_above_the_least_height_of_its_phase() -> None:
    np.testing.assert_array_equal(TARGET.within_reach(franka(), lowest=0.35).pose.position, (0.4, -0.1, 0.35))
    assert TARGET.within_reach(franka(), lowest=0.29).pose is TARGET.pose


def test_a_target_is_laid_out_flat_as_position_quaternion_and_width() -> None:
    flat = TARGET.flat()
    np.testing.assert_array_equal(flat[:3], TARGET.pose.position)
    np.testing.assert_allclose(matrix_from_quat(flat[3:7]), ROTATION, atol=1e-12)
    assert (flat.shape, flat[7]) == ((8,), 0.05)
