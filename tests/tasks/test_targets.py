from __future__ import annotations

import math

import numpy as np
import pytest
from hand_made import scene, view

from dynaforge.geometry import Pose, rotation_z
from dynaforge.tasks.targets import DOWN_ALONG_X, Above, Downstream, Raised, distance_to_disc, nearer_half_turn
from dynaforge.tasks.view import heading_frames


def test_above_is_straight_above_and_closes_along_the_heading() -> None:
    target = Above("can", 0.085)(view(scene((0.4, -0.3, 0.033), (0.0, 0.7, 0.0))))
    np.testing.assert_allclose(target.position, (0.4, -0.3, 0.118))
    np.testing.assert_allclose(target.rotation[:, 2], (0, 0, -1), atol=1e-12)  # pointing down
    np.testing.assert_allclose(np.abs(target.rotation[:, 1]), (0, 1, 0), atol=1e-12)  # fingers open along y, its way


def test_the_prior_does_not_predict() -> None:
    """Eq. 3: two cans at the same place along the same line give the same target, however fast they are."""
    slow = Above("can", 0.0)(view(scene(velocity=(0.0, 0.1, 0.0))))
    fast = Above("can", 0.0)(view(scene(velocity=(0.0, 1.5, 0.0))))
    np.testing.assert_array_equal(slow.position, fast.position)
    np.testing.assert_array_equal(slow.rotation, fast.rotation)


def test_lead_time_moves_the_target_by_velocity_times_lead() -> None:
    state = scene(velocity=(0.3, -0.4, 0.0))
    latest, led = Above("can", 0.1)(view(state)), Above("can", 0.1)(view(state, lead_time=0.05))
    np.testing.assert_allclose(led.position - latest.position, (0.015, -0.02, 0.0), atol=1e-15)


def test_above_follows_the_object_and_downstream_and_raised_stay_where_entry_put_them() -> None:
    entry = scene((0.5, -0.9, 0.033), (0.0, 0.5, 0.0))
    later = scene((0.5, -0.6, 0.033), (0.0, 0.5, 0.0), hand=(0.4, 0.1, 0.3))
    for target in (Downstream("can", 0.085, 0.6, 0.08), Raised("can", 0.15)):
        at_entry, afterwards = target(view(entry)), target(view(later, entry=entry))
        np.testing.assert_array_equal(at_entry.position, afterwards.position)
        np.testing.assert_array_equal(at_entry.rotation, afterwards.rotation)
    assert Above("can", 0.0)(view(later, entry=entry)).position[1] == -0.6


def test_downstream_meets_the_object_where_its_line_enters_the_reach() -> None:
    """A line x = 0.36 enters a disc of 0.6 m at y = -0.48: sides 36-48-60."""
    target = Downstream("can", 0.085, 0.6, 0.08)(view(scene((0.36, -1.5, 0.033), (0.0, 1.2, 0.0))))
    np.testing.assert_allclose(target.position, (0.36, -0.48, 0.118), atol=1e-12)


def test_downstream_is_ahead_of_an_object_already_inside() -> None:
    target = Downstream("can", 0.085, 0.6, 0.08)(view(scene((0.36, -0.2, 0.033), (0.0, 0.05, 0.0))))
    np.testing.assert_allclose(target.position, (0.36, -0.12, 0.118), atol=1e-12)


def test_raised_keeps_the_hand_upright_above_itself() -> None:
    target = Raised("can", 0.15)(view(scene(hand=(0.5, 0.1, 0.03))))
    np.testing.assert_allclose(target.position, (0.5, 0.1, 0.18))
    np.testing.assert_array_equal(target.rotation, DOWN_ALONG_X)


@pytest.mark.parametrize(
    ("place", "angle", "distance"),
    [
        ((0.0, -1.0), math.pi / 2, 0.4),  # straight at the axis
        ((0.36, -1.0), math.pi / 2, 0.52),
        ((0.9, -1.0), math.pi / 2, 1.0),  # misses the disc: the nearest point
        ((0.0, -0.6), math.pi / 2, 0.0),  # on its edge
        ((0.0, 0.0), 0.3, -0.6),  # inside
    ],
)
def test_distance_to_disc(place: tuple[float, float], angle: float, distance: float) -> None:
    frame = Pose(rotation_z(angle), np.array((*place, 0.0)))
    assert distance_to_disc(frame, 0.6) == pytest.approx(distance, abs=1e-12)


@pytest.mark.parametrize("angle", np.linspace(-math.pi, math.pi, 13))
def test_a_grasp_turns_by_at_most_a_quarter_from_where_the_hand_is(angle: float) -> None:
    wanted = rotation_z(angle) @ DOWN_ALONG_X
    chosen = nearer_half_turn(wanted, DOWN_ALONG_X)
    cosine = (np.trace(chosen.T @ DOWN_ALONG_X) - 1) / 2
    assert cosine >= -1e-9
    axis = chosen[:, 1] @ wanted[:, 1]
    assert abs(axis) == pytest.approx(1.0)  # the fingers close along the same line
    assert np.linalg.det(chosen) == pytest.approx(1.0)


def test_the_heading_frame_has_x_along_the_velocity_and_z_up() -> None:
    frame = heading_frames(scene((0.1, 0.2, 0.3), (0.3, 0.4, -5.0)), None)["can"]
    np.testing.assert_allclose(frame.rotation[:, 0], (0.6, 0.8, 0.0), atol=1e-12)
    np.testing.assert_allclose(frame.rotation[:, 2], (0, 0, 1), atol=1e-12)
    np.testing.assert_array_equal(frame.position, (0.1, 0.2, 0.3))


def test_a_slow_object_keeps_its_last_heading() -> None:
    before = heading_frames(scene(velocity=(0.0, 0.021, 0.0)), None)
    stopped = heading_frames(scene((0.6, 0.0, 0.033), velocity=(0.019, 0.0, 0.0)), before)["can"]
    np.testing.assert_array_equal(stopped.rotation, before["can"].rotation)
    assert stopped.position[0] == 0.6
