from __future__ import annotations

import math

import pytest
from hand_made import body, scene, scene_of, view

from dynaforge.geometry import Pose, matrix_from_rotvec
from dynaforge.tasks.predicates import (
    Aligned,
    All,
    Around,
    AtRestOn,
    Clicked,
    Departed,
    Fallen,
    Grasped,
    Lifted,
    Narrowed,
    Near,
    Not,
    OnTable,
    Reached,
    Released,
    Touched,
    Upright,
    Within,
)

NOWHERE = Pose.identity()


def test_lifted_measures_from_the_start_of_the_episode_and_not_of_the_phase() -> None:
    start, low, high = scene(), scene((0.5, 0.0, 0.10)), scene((0.5, 0.0, 0.14))
    assert Lifted("can", 0.10)(view(high, entry=low, start=start), NOWHERE)
    assert not Lifted("can", 0.10)(view(high, entry=low, start=low), NOWHERE)


@pytest.mark.parametrize(("height", "holds"), [(0.132, False), (0.1331, True)])
def test_lifted_needs_the_whole_height(height: float, holds: bool) -> None:
    assert Lifted("can", 0.10)(view(scene((0.5, 0.0, height)), start=scene()), NOWHERE) is holds


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize("right", [False, True])
def test_touched_needs_one_finger_and_grasped_both(left: bool, right: bool) -> None:
    seen = view(scene(touching=(left, right)))
    assert Touched("can")(seen, NOWHERE) is (left or right)
    assert Grasped("can")(seen, NOWHERE) is (left and right)


def test_all_needs_every_part() -> None:
    seen = view(scene(touching=(True, False)))
    assert All((Touched("can"), Touched("can")))(seen, NOWHERE)
    assert not All((Touched("can"), Grasped("can")))(seen, NOWHERE)


@pytest.mark.parametrize(("z", "holds"), [(0.229, True), (0.231, False)])
def test_reached_measures_in_space(z: float, holds: bool) -> None:
    target = Pose.from_quat((0.5, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0))
    assert Reached(0.03)(view(scene(hand=(0.5, 0.0, z))), target) is holds


def test_near_measures_on_the_plane() -> None:
    """Hand 3-4-5: 30 mm and 40 mm aside are 50 mm, whatever the height."""
    seen = view(scene((0.5, 0.0, 0.033), hand=(0.53, 0.04, 0.9)))
    assert Near("can", 0.0501)(seen, NOWHERE)
    assert not Near("can", 0.0499)(seen, NOWHERE)


@pytest.mark.parametrize(
    ("hand", "holds"),
    [
        ((0.5, 0.0, 0.044), True),
        ((0.5, 0.0, 0.046), False),  # 13 mm above the centre
        ((0.521, 0.0, 0.033), False),  # 21 mm aside
        ((0.519, 0.0, 0.033), True),
    ],
)
def test_aligned_limits_offset_and_height(hand: tuple[float, float, float], holds: bool) -> None:
    assert Aligned("can", 0.02, height=0.012)(view(scene(hand=hand)), NOWHERE) is holds


def test_aligned_without_a_height_does_not_care_about_it() -> None:
    assert Aligned("can", 0.012)(view(scene(hand=(0.51, 0.0, 0.7))), NOWHERE)


@pytest.mark.parametrize(("z", "holds"), [(-0.04, False), (-0.06, True)])
def test_fallen_is_below_the_table_top(z: float, holds: bool) -> None:
    assert Fallen("can")(view(scene((0.5, 0.0, z))), NOWHERE) is holds


@pytest.mark.parametrize(
    ("place", "velocity", "holds"),
    [
        ((0.5, 0.6, 0.033), (0.0, 0.5, 0.0), True),  # 0.78 m out, going
        ((0.5, 0.6, 0.033), (0.0, -0.5, 0.0), False),  # 0.78 m out, coming
        ((0.5, 0.5, 0.033), (0.0, 0.5, 0.0), False),  # 0.71 m out
        ((0.5, 0.6, 0.033), (0.0, 0.0, 0.0), True),  # lies still where it cannot be reached
    ],
)
def test_departed_is_outside_and_not_coming_back(
    place: tuple[float, float, float], velocity: tuple[float, float, float], holds: bool
) -> None:
    assert Departed("can", 0.75)(view(scene(place, velocity)), NOWHERE) is holds


def test_predicates_answer_with_plain_booleans() -> None:
    seen = view(scene())
    words = (Reached(0.1), Near("can", 0.1), Aligned("can", 0.1), Aligned("can", 0.1, math.pi), Touched("can"))
    for predicate in (*words, Grasped("can"), Lifted("can", 0.1), Fallen("can"), Departed("can", 0.7), All(words)):
        assert type(predicate(seen, NOWHERE)) is bool, predicate


def test_not_is_the_opposite() -> None:
    seen = view(scene(touching=(True, False)))
    assert Not(Grasped("can"))(seen, NOWHERE)
    assert not Not(Touched("can"))(seen, NOWHERE)


def test_around_measures_in_space() -> None:
    seen = view(scene((0.5, 0.0, 0.033), hand=(0.52, 0.02, 0.043)))  # 2-2-1: 30 mm
    assert Around("can", 0.0301)(seen, NOWHERE)
    assert not Around("can", 0.0299)(seen, NOWHERE)


@pytest.mark.parametrize(
    ("hand", "holds"), [((0.52, 0.005, 0.2), True), ((0.5, 0.015, 0.2), False), ((0.535, 0.0, 0.2), False)]
)
def test_aligned_may_ask_for_less_across_the_heading(hand: tuple[float, float, float], holds: bool) -> None:
    """The can rolls along y: 30 mm of its axis along x are allowed, 10 mm along its way."""
    seen = view(scene(velocity=(0.0, 0.3, 0.0), hand=hand))
    assert Aligned("can", 0.01, 0.03)(seen, NOWHERE) is holds


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize("right", [False, True])
def test_released_is_touched_by_none(left: bool, right: bool) -> None:
    assert Released("can")(view(scene(touching=(left, right))), NOWHERE) is not (left or right)


def test_narrowed_reads_the_measured_opening() -> None:
    assert Narrowed(0.05)(view(scene_of(width=0.049)), NOWHERE)
    assert not Narrowed(0.05)(view(scene_of(width=0.051)), NOWHERE)


@pytest.mark.parametrize(
    ("tip", "holds"),
    [((0.6, 0.2, 0.01), True), ((0.609, 0.2, 0.01), True), ((0.611, 0.2, 0.01), False), ((0.6, 0.2, 0.03), False)],
)
def test_within_looks_at_the_tool_point_and_not_at_the_origin(tip: tuple[float, float, float], holds: bool) -> None:
    """A pen that leans by 30 degrees, its tip 70 mm down its own axis."""
    lean = matrix_from_rotvec((0.0, math.pi / 6, 0.0))
    origin = tuple(tip + lean @ (0.0, 0.0, 0.07))
    seen = view(scene_of(pen=body(origin, lean), cup=body((0.6, 0.2, 0.0))))
    assert Within("pen", "cup", 0.010, 0.02, tool=(0.0, 0.0, -0.07))(seen, NOWHERE) is holds


@pytest.mark.parametrize(("tilt", "holds"), [(0.15, True), (0.25, False), (math.pi - 0.1, True), (math.pi / 2, False)])
def test_upright_counts_either_way_up(tilt: float, holds: bool) -> None:
    seen = view(scene_of(cube=body((0.5, 0.0, 0.1), matrix_from_rotvec((tilt, 0.0, 0.0)))))
    assert Upright("cube", 0.2)(seen, NOWHERE) is holds


def test_at_rest_on_a_turning_body_means_to_turn_with_it() -> None:
    """10 cm beside the axis of a table that turns at 2 rad/s and moves on at 0.1 m/s: 0.2 m/s along y on top."""
    table = body((0.5, 0.0, 0.0), velocity=(0.1, 0.0, 0.0), angular_velocity=(0.0, 0.0, 2.0))
    along = view(scene_of(cup=table, ball=body((0.6, 0.0, 0.03), velocity=(0.1, 0.2, 0.0))))
    still = view(scene_of(cup=table, ball=body((0.6, 0.0, 0.03))))
    assert AtRestOn("ball", "cup", 0.01)(along, NOWHERE)
    assert not AtRestOn("ball", "cup", 0.05)(still, NOWHERE)


@pytest.mark.parametrize(
    ("change", "holds"),
    [
        ({}, True),
        ({"touching": {"clock": (False, False)}}, False),  # pressed by something else
        ({"pressed": {"clock": 0.004}}, False),  # not far enough
        ({"width": 0.02}, False),  # with open fingers
        ({"clock": body((0.51, 0.0, 0.1))}, False),  # 10 mm off centre
    ],
)
def test_clicked_takes_a_closed_fingertip_on_the_middle_of_the_button(change: dict[str, object], holds: bool) -> None:
    usual = {
        "clock": body((0.505, 0.0, 0.1)),
        "width": 0.0,
        "touching": {"clock": (True, False)},
        "pressed": {"clock": 0.006},
    }
    assert Clicked("clock", 0.005, 0.008)(view(scene_of(**(usual | change))), NOWHERE) is holds


def test_on_table_is_a_contact() -> None:
    assert OnTable("can")(view(scene()), NOWHERE)
    assert not OnTable("can")(view(scene((0.5, 0.0, 0.2))), NOWHERE)
