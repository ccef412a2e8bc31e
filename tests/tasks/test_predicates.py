from __future__ import annotations

import math

import pytest
from hand_made import scene, view

from dynaforge.geometry import Pose
from dynaforge.tasks.predicates import Aligned, All, Departed, Fallen, Grasped, Lifted, Near, Reached, Touched

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
