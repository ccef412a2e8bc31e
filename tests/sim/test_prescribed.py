"""A body that is driven along a path is where the path says; every other episode keeps its bits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dynaforge.sim import SceneState, SimScene
from dynaforge.sim.prescribed import PrescribedMotion
from dynaforge.tasks import get_task

TASK = get_task("can").under(physics="fixed")
CONDITION = TASK.conditions.draw(np.random.default_rng(0))
LYING = (np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0)
# Half a second at (0, 0.08) m/s, then half a second at (-0.1, 0.04) m/s, to (0.5, 0, 0.033).
BENT = PrescribedMotion(
    body="can",
    quat_wxyz=LYING,
    end=(0.5, 0.0, 0.033),
    knots=(0.0, 0.5, 1.0),
    pieces=(((0.55,), (-0.06, 0.08), (0.033,)), ((0.55, -0.1), (-0.02, 0.04), (0.033,))),
)


@pytest.fixture(scope="module")
def scene() -> Iterator[SimScene]:
    scene = SimScene(TASK.simulated)
    yield scene
    scene.close()


def run(scene: SimScene, motion: PrescribedMotion | None, steps: int = 40) -> list[SceneState]:
    start = scene.reset(CONDITION, prescribed=motion)
    return [start, *(scene.step(scene.robot.q_ready, 0.08) for _ in range(steps))]


def bits(states: list[SceneState]) -> bytes:
    return b"".join(
        array.tobytes() for state in states for array in (state.q, *(state.objects["can"].columns.values()))
    )


def test_the_body_is_where_its_path_says_at_every_control_step(scene: SimScene) -> None:
    states = run(scene, BENT)
    for k, state in enumerate(states[:31]):
        body, time = state.objects["can"], k / 30
        x = 0.55 if time <= 0.5 else 0.55 - 0.1 * (time - 0.5)
        y = -0.06 + 0.08 * time if time <= 0.5 else -0.02 + 0.04 * (time - 0.5)
        np.testing.assert_allclose(body.pose.position, (x, y, 0.033), atol=1e-12)
        np.testing.assert_allclose(np.abs(body.pose.quat_wxyz @ LYING), 1.0, atol=1e-12)
        speed = (0.0, 0.08, 0.0) if k < 15 else (-0.1, 0.04, 0.0) if k < 30 else (0.0, 0.0, 0.0)
        np.testing.assert_allclose(body.velocity, speed, atol=1e-10)
        assert not body.angular_velocity.any()
    assert states[30].objects["can"].pose.position.tolist() == [0.5, 0.0, 0.033]
    assert scene.prescribed_until == 1.0


def test_physics_takes_over_at_rest_and_with_the_bodys_own_mass(scene: SimScene) -> None:
    states = run(scene, BENT)
    still = [state.objects["can"].pose.position for state in states[30:]]
    assert np.ptp(still, axis=0).max() < 1e-3
    mass = scene._bullet.client.getDynamicsInfo(scene._bullet.free["can"].body, -1)[0]
    assert mass == CONDITION.values["mass"]


def test_wheels_do_not_turn_on_the_way() -> None:
    task = get_task("toycar").under(physics="fixed")
    scene = SimScene(task.simulated)
    way = ((0.4, 0.2), (0.0,), (0.026,))
    motion = PrescribedMotion(
        body="toycar", quat_wxyz=(1.0, 0.0, 0.0, 0.0), end=(0.5, 0.0, 0.026), knots=(0.0, 0.5), pieces=(way,)
    )
    scene.reset(task.conditions.draw(np.random.default_rng(0)), prescribed=motion)
    client, car = scene._bullet.client, scene._bullet.free["toycar"]
    for _ in range(15):
        state = scene.step(scene.robot.q_ready, 0.08)
        assert [client.getJointState(car.body, joint)[1] for joint in car.joints.values()] == [0.0] * 4
    for _ in range(15):
        later = scene.step(scene.robot.q_ready, 0.08)
    scene.close()
    moved = later.objects["toycar"].pose.position - state.objects["toycar"].pose.position
    assert np.linalg.norm(moved) < 1e-3, "at the end it stands"


def test_what_is_driven_pushes_and_is_not_pushed(scene: SimScene) -> None:
    """A can that goes through the place of the hand moves it, and keeps its way to the micrometre."""
    hand = scene.reset(CONDITION).ee.position
    way = ((hand[0],), (hand[1] - 0.16, 0.16), (hand[2],))
    motion = replace(BENT, end=tuple(hand.tolist()), knots=(0.0, 1.0), pieces=(way,))
    states = [scene.reset(CONDITION, prescribed=motion)]
    for _ in range(30):
        states.append(scene.step(scene.robot.q_ready, 0.08))
        assert scene.overlaps()["robot", "can"] < 0.002, "it is a wall; at 0.5 kg, the hand sinks in by 4 mm"
    touched = [k for k, state in enumerate(states) if state.contacts.robot_force("can") > 0.0]
    assert touched
    for k in touched:
        np.testing.assert_allclose(states[k].objects["can"].pose.position, motion.position(k / 30), atol=1e-9)
    assert np.linalg.norm(states[-1].ee.position - hand) > 5e-3


def test_released_at_contact_it_goes_on_as_physics_says(scene: SimScene) -> None:
    hand = scene.reset(CONDITION).ee.position
    way = ((hand[0],), (hand[1] - 0.16, 0.16), (hand[2],))
    motion = replace(BENT, end=tuple(hand.tolist()), knots=(0.0, 1.0), pieces=(way,), release="contact")
    states = run(scene, motion, 30)
    first = next(k for k, state in enumerate(states) if state.contacts.robot_force("can") > 0.0)
    assert (first - 1) / 30 < scene.prescribed_until <= first / 30 + 1e-9
    off = [np.linalg.norm(s.objects["can"].pose.position - motion.position(k / 30)) for k, s in enumerate(states)]
    assert max(off[:first]) < 1e-9
    assert off[-1] > 1e-2, "it falls, and the hand holds it up no more than physics does"


def test_episodes_without_a_path_keep_their_bits(scene: SimScene) -> None:
    before = bits(run(scene, None))
    driven = bits(run(scene, BENT))
    assert bits(run(scene, None)) == before != driven
    assert bits(run(scene, BENT)) == driven
    run(scene, BENT, 10)  # and one that ends on its way
    assert bits(run(scene, None)) == before
    assert scene.prescribed_until == 0.0


def test_a_body_that_only_stands_is_left_to_physics(scene: SimScene) -> None:
    standing = replace(BENT, knots=(0.0,), pieces=())
    states = run(scene, standing, 20)
    assert states[0].objects["can"].pose.position.tolist() == [0.5, 0.0, 0.033]
    assert scene.prescribed_until == 0.0
    scene.step(scene.robot.q_ready, 0.08)
    assert states[-1].on_table["can"]


def test_an_episode_with_a_path_is_not_saved(scene: SimScene) -> None:
    run(scene, BENT, 3)
    with pytest.raises(RuntimeError, match="cannot be saved"):
        scene.save()
    run(scene, None, 3)
    scene.save()
    run(scene, BENT, 1)
    assert scene.saved is None, "a world that was saved is not one of this episode"


def test_fixtures_that_should_stand_still_do() -> None:
    task = get_task("block").under(physics="fixed")
    condition = task.conditions.draw(np.random.default_rng(1))
    scene = SimScene(task.simulated)
    pose = task.scene.starts(condition)["block"].pose
    motion = PrescribedMotion(body="block", quat_wxyz=tuple(pose.quat_wxyz), end=tuple(pose.position), still=("tray",))
    states = [scene.reset(condition, prescribed=motion), *(scene.step(scene.robot.q_ready, 0.08) for _ in range(15))]
    moved = {name: np.ptp([s.objects[name].pose.position for s in states], axis=0).max() for name in states[0].objects}
    assert moved["tray"] < 1e-4 < moved["pad"]
    scene.close()


def test_plain_data_gives_the_same_motion() -> None:
    assert PrescribedMotion.from_dict(BENT.to_dict()) == BENT


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"body": 3}, "body"),
        ({"quat_wxyz": (1.0, 1.0, 0.0, 0.0)}, "no unit quaternion"),
        ({"quat_wxyz": (1.0, 0.0, 0.0)}, "4 numbers"),
        ({"end": (0.5, 0.1, 0.033)}, "gap at 1 s"),
        ({"knots": (0.0, 0.6, 1.0)}, "gap at 0.6 s"),
        ({"knots": (0.0, 0.5)}, "3 numbers"),
        ({"knots": (0.1, 0.5, 1.0)}, "begin with 0"),
        ({"knots": (0.0, 1.0, 0.5)}, "increase"),
        ({"pieces": (((0.5,) * 7, (0.0,), (0.0,)),), "knots": (0.0, 1.0)}, "1 to 6 coefficients"),
        ({"pieces": (((float("nan"),), (0.0,), (0.0,)),), "knots": (0.0, 1.0)}, "finite"),
        ({"release": "never"}, "release"),
    ],
)
def test_a_malformed_motion_is_refused_in_words(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(BENT, **changes)


def test_a_motion_of_another_scene_is_refused_before_anything_changes(scene: SimScene) -> None:
    before = bits(run(scene, None, 3))
    for motion in (replace(BENT, body="cane"), replace(BENT, still=("tray",))):
        with pytest.raises(ValueError, match=r"cane|tray"):
            scene.reset(CONDITION, prescribed=motion)
    with pytest.raises(ValueError, match="unexpected keyword"):
        PrescribedMotion.from_dict({"name": "can"})
    assert bits(run(scene, None, 3)) == before
