"""Poses form a group; rotations survive every change of representation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dynaforge.geometry import (
    JointTrajectory,
    Pose,
    matrix_from_quat,
    matrix_from_rotation_6d,
    matrix_from_rotvec,
    quat_from_matrix,
    rotation_6d_from_matrix,
    rotation_z,
    rotvec_from_matrix,
)


def random_pose(rng: np.random.Generator) -> Pose:
    return Pose.from_quat(rng.normal(size=3), rng.normal(size=4))


def assert_same(a: Pose, b: Pose) -> None:
    np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-12)
    np.testing.assert_allclose(a.position, b.position, atol=1e-12)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_poses_form_a_group(rng: np.random.Generator) -> None:
    for _ in range(20):
        a, b, c = (random_pose(rng) for _ in range(3))
        assert_same((a @ b) @ c, a @ (b @ c))
        assert_same(a @ Pose.identity(), a)
        assert_same(Pose.identity() @ a, a)
        assert_same(a @ a.inverse(), Pose.identity())
        assert_same(a.inverse() @ a, Pose.identity())


def test_composition_applies_the_right_pose_first(rng: np.random.Generator) -> None:
    a, b, points = random_pose(rng), random_pose(rng), rng.normal(size=(4, 3))
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-12)


def test_inner_frames_cancel_in_a_case_worked_by_hand() -> None:
    T_world_object = Pose(rotation_z(math.pi / 2), np.array((1.0, 0.0, 0.0)))
    T_object_ee = Pose(np.eye(3), np.array((0.5, 0.0, 0.2)))
    np.testing.assert_allclose((T_world_object @ T_object_ee).position, (1.0, 0.5, 0.2), atol=1e-12)


def test_quaternions_are_wxyz() -> None:
    half = math.sqrt(0.5)
    np.testing.assert_allclose(matrix_from_quat((half, 0.0, 0.0, half)), rotation_z(math.pi / 2), atol=1e-12)
    np.testing.assert_allclose(Pose(rotation_z(math.pi / 2), np.zeros(3)).quat_wxyz, (half, 0, 0, half), atol=1e-12)


def test_quaternions_roundtrip_with_positive_w(rng: np.random.Generator) -> None:
    # Half turns make w vanish: each axis takes another branch of the conversion.
    half_turns = [(0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)]
    for quat in [*rng.normal(size=(100, 4)), *half_turns]:
        rotation = matrix_from_quat(quat)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        back = quat_from_matrix(rotation)
        assert back[0] >= 0
        assert np.linalg.norm(back) == pytest.approx(1.0)
        np.testing.assert_allclose(matrix_from_quat(back), rotation, atol=1e-12)


def test_a_quaternion_of_any_length_gives_the_same_rotation(rng: np.random.Generator) -> None:
    quat = rng.normal(size=4)
    np.testing.assert_allclose(matrix_from_quat(3.0 * quat), matrix_from_quat(quat), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-7, 1e-3, 1.0, 3.0, math.pi - 1e-6])
def test_rotation_vectors_roundtrip_at_every_angle(angle: float, rng: np.random.Generator) -> None:
    axis = rng.normal(size=3)
    rotvec = angle * axis / np.linalg.norm(axis)
    np.testing.assert_allclose(rotvec_from_matrix(matrix_from_rotvec(rotvec)), rotvec, atol=1e-9)


def test_a_rotation_vector_along_z_is_a_turn_about_z() -> None:
    np.testing.assert_allclose(matrix_from_rotvec((0.0, 0.0, 0.7)), rotation_z(0.7), atol=1e-12)


def test_rotation_vectors_are_never_longer_than_pi(rng: np.random.Generator) -> None:
    for _ in range(50):
        rotvec = rotvec_from_matrix(matrix_from_rotvec(rng.normal(size=3) * 4.0))
        assert np.linalg.norm(rotvec) <= math.pi + 1e-9


def test_a_trajectory_lasts_from_first_to_last_sample() -> None:
    samples = np.zeros((4, 7))
    trajectory = JointTrajectory(0.1, samples, samples, samples)
    assert len(trajectory) == 4
    assert trajectory.duration == pytest.approx(0.3)


def test_six_numbers_give_the_rotation_back_from_any_length_and_lean(rng: np.random.Generator) -> None:
    for _ in range(20):
        rotation = random_pose(rng).rotation
        six = rotation_6d_from_matrix(rotation)
        np.testing.assert_array_equal(six, (*rotation[:, 0], *rotation[:, 1]))
        np.testing.assert_allclose(matrix_from_rotation_6d(six), rotation, atol=1e-12)
        leaning = np.concatenate((3.0 * six[:3], 0.2 * six[3:] + 0.7 * six[:3]))
        np.testing.assert_allclose(matrix_from_rotation_6d(leaning), rotation, atol=1e-12)


def test_six_numbers_do_not_jump_at_a_half_turn() -> None:
    before, after = (rotation_6d_from_matrix(rotation_z(math.pi + turn)) for turn in (-1e-6, 1e-6))
    np.testing.assert_allclose(before, after, atol=1e-5)


@pytest.mark.parametrize("six", [(0, 0, 0, 0, 1, 0), (1, 0, 0, 0, 0, 0), (1, 2, 0, 2, 4, 0), (math.nan,) * 6])
def test_six_numbers_that_span_no_plane_are_refused(six: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="neither zero nor parallel"):
        matrix_from_rotation_6d(six)
