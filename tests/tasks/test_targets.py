from __future__ import annotations

import math

import numpy as np
import pytest
from hand_made import body, scene, scene_of, view

from dynaforge.geometry import Pose, matrix_from_rotvec, rotation_z
from dynaforge.tasks.targets import (
    DOWN_ALONG_X,
    DOWN_ALONG_Y,
    Above,
    Catching,
    Downstream,
    Grip,
    Over,
    Raised,
    distance_to_disc,
    nearer_half_turn,
    straight_down,
)
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
    for target in (Downstream("can", 0.085, reach=0.6, clearance=0.08), Raised("can", 0.15)):
        at_entry, afterwards = target(view(entry)), target(view(later, entry=entry))
        np.testing.assert_array_equal(at_entry.position, afterwards.position)
        np.testing.assert_array_equal(at_entry.rotation, afterwards.rotation)
    assert Above("can", 0.0)(view(later, entry=entry)).position[1] == -0.6


def test_downstream_meets_the_object_where_its_line_enters_the_reach() -> None:
    """A line x = 0.36 enters a disc of 0.6 m at y = -0.48: sides 36-48-60."""
    target = Downstream("can", 0.085, reach=0.6, clearance=0.08)(view(scene((0.36, -1.5, 0.033), (0.0, 1.2, 0.0))))
    np.testing.assert_allclose(target.position, (0.36, -0.48, 0.118), atol=1e-12)


def test_downstream_is_ahead_of_an_object_already_inside() -> None:
    target = Downstream("can", 0.085, reach=0.6, clearance=0.08)(view(scene((0.36, -0.2, 0.033), (0.0, 0.05, 0.0))))
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


def fingers(target: Pose) -> np.ndarray:
    """Direction in which the fingers open, up to its sign."""
    y = target.rotation[:, 1]
    return y * np.sign(y[np.abs(y).argmax()])


@pytest.mark.parametrize(
    ("grip", "opens"),
    [
        (Grip.ALONG, (0.0, 1.0, 0.0)),  # it moves along y
        (Grip.ACROSS, (1.0, 0.0, 0.0)),
        (Grip.FACES, (np.cos(0.3), np.sin(0.3), 0.0)),  # the box is turned by 0.3
        (Grip.KEPT, (np.cos(0.1), np.sin(0.1), 0.0)),  # the hand stood so
    ],
)
def test_a_grip_says_how_the_fingers_stand(grip: Grip, opens: tuple[float, float, float]) -> None:
    box = body((0.5, 0.0, 0.02), rotation_z(0.3), velocity=(0.0, 0.2, 0.0))
    hand = Pose(rotation_z(0.1) @ DOWN_ALONG_X, np.array((0.5, 0.0, 0.3)))
    target = Above("box", 0.1, grip)(view(scene_of(ee=hand, box=box)))
    np.testing.assert_allclose(fingers(target), opens, atol=1e-12)
    np.testing.assert_allclose(target.rotation[:, 2], (0, 0, -1), atol=1e-12)
    assert np.linalg.det(target.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("turn", np.arange(-3.0, 3.1, 0.5))
def test_of_the_faces_of_a_box_the_nearer_pair_is_gripped(turn: float) -> None:
    hand = Pose(rotation_z(0.1) @ DOWN_ALONG_Y, np.array((0.5, 0.0, 0.3)))
    target = Above("box", 0.1, Grip.FACES)(view(scene_of(ee=hand, box=body((0.5, 0.0, 0.02), rotation_z(turn)))))
    angle = np.arccos((np.trace(target.rotation @ hand.rotation.T) - 1) / 2)
    assert angle <= np.pi / 4 + 1e-9
    across = rotation_z(-turn) @ target.rotation[:, 1]
    assert np.abs(across).max() == pytest.approx(1.0)


def test_downstream_live_follows_the_heading_of_now() -> None:
    entry = scene((0.45, -1.0, 0.033), (0.0, 0.5, 0.0))
    now = scene((0.45, -1.0, 0.033), (0.3, 0.4, 0.0))
    kept, live = (
        Downstream("can", 0.1, reach=0.6, clearance=0.08, live=live)(view(now, entry=entry)) for live in (False, True)
    )
    np.testing.assert_allclose(kept.position[0], 0.45)
    np.testing.assert_allclose(
        live.position[:2] - (0.45, -1.0), np.linalg.norm(live.position[:2] - (0.45, -1.0)) * np.array((0.6, 0.8))
    )


def test_catching_is_fixed_in_the_fixture_and_moves_sideways_with_the_object() -> None:
    """A ledge that sends its lemon along -x: the hand faces +x, pitched up by 30 degrees, 5 cm off the edge."""
    ledge = body((0.8, 0.1, 0.3), rotation_z(np.pi))
    word = Catching("lemon", "ledge", ahead=0.05, height=-0.02, pitch=np.pi / 6)
    for lemon in ((1.2, 0.13, 0.4), (0.9, 0.13, 0.35)):
        target = word(view(scene_of(ledge=ledge, lemon=body(lemon))))
        np.testing.assert_allclose(target.position, (0.75, 0.13, 0.28), atol=1e-12)
        np.testing.assert_allclose(target.rotation[:, 2], (np.cos(np.pi / 6), 0, 0.5), atol=1e-12)
        np.testing.assert_allclose(fingers(target), (0, 1, 0), atol=1e-12)
        assert np.linalg.det(target.rotation) == pytest.approx(1.0)


def test_over_brings_the_tool_point_and_not_the_hand_there() -> None:
    """A pen grasped 20 mm beside the hand's axis and 30 mm below, leaning: its tip ends above the cup, upright."""
    lean = matrix_from_rotvec((0.2, 0.0, 0.0))
    hand = Pose(rotation_z(0.4) @ DOWN_ALONG_Y, np.array((0.5, 0.0, 0.3)))
    grasp = scene_of(ee=hand, pen=body((0.52, 0.0, 0.27), lean), cup=body((0.6, 0.2, 0.05)))
    tool = (0.0, 0.0, -0.07)
    target = Over("cup", "pen", 0.03, tool=tool, upright=True)(view(grasp, grasp=grasp))
    T_world_pen = target @ (hand.inverse() @ grasp.objects["pen"].pose)
    np.testing.assert_allclose(T_world_pen.apply(np.array(tool)), (0.6, 0.2, 0.08), atol=1e-12)
    np.testing.assert_allclose(T_world_pen.rotation[:, 2], (0, 0, 1), atol=1e-12)
    crooked = Over("cup", "pen", 0.03, tool=tool)(view(grasp, grasp=grasp))
    np.testing.assert_allclose(crooked.rotation, hand.rotation, atol=1e-12)
    np.testing.assert_allclose(
        (crooked @ (hand.inverse() @ grasp.objects["pen"].pose)).apply(np.array(tool)), (0.6, 0.2, 0.08)
    )


def test_over_goes_by_the_grasp_and_not_by_what_slipped_since() -> None:
    grasp = scene_of(pen=body((0.5, 0.0, 0.27)), cup=body((0.6, 0.2, 0.05)))
    slipped = scene_of(pen=body((0.5, 0.0, 0.20)), cup=body((0.6, 0.2, 0.05)))
    word = Over("cup", "pen", 0.03)
    np.testing.assert_array_equal(word(view(slipped, grasp=grasp)).position, word(view(grasp, grasp=grasp)).position)
    assert word(view(slipped)).position[2] > word(view(slipped, grasp=grasp)).position[2]


@pytest.mark.parametrize("turn", [0.0, 1.0, 3.0, -2.0])
def test_straight_down_keeps_the_fingers_direction(turn: float) -> None:
    tilted = matrix_from_rotvec((0.1, 0.0, 0.0)) @ rotation_z(turn) @ DOWN_ALONG_Y
    down = straight_down(tilted)
    np.testing.assert_allclose(down[:, 2], (0, 0, -1), atol=1e-12)
    np.testing.assert_allclose(down[:, 1] @ tilted[:, 1], 1.0, atol=0.01)
    np.testing.assert_allclose(
        straight_down(rotation_z(turn) @ DOWN_ALONG_Y), rotation_z(turn) @ DOWN_ALONG_Y, atol=1e-12
    )
