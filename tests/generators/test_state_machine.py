"""The state machine of DynamicVLA's collector: its table row by row, the grasp it aims at, and what it grasps."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from dynaforge.cli.main import main
from dynaforge.demos.schema import validate_steps
from dynaforge.generators.by_name import make_generator
from dynaforge.generators.names import COLLECTING, GENERATORS
from dynaforge.generators.state_machine import FINAL, Memory, State, StateMachine, StateMachineGenerator
from dynaforge.generators.state_machine_sight import SIZES, Sight, Skill, grasp_yaw, skill_for
from dynaforge.geometry import Pose, rotation_z
from dynaforge.sim import BodyState, Condition, HandTarget, SceneState
from dynaforge.tasks import Task, get_task
from dynaforge.tasks.targets import DOWN_ALONG_Y

STILL = (0.0, 0.0, 0.0)
ALONG_X = np.array(((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))  # a can that lies along the x axis
CAN = Skill(object="can", size=SIZES["can"])
PEACH = Skill(
    object="peach", size=SIZES["peach"], ball=True, container="bowl", container_size=(0.1, 0.1, 0.03), closed=0.05
)
LIFTS, PLACES = StateMachine(CAN), StateMachine(PEACH)
HOME = Pose(DOWN_ALONG_Y, np.array((0.4, 0.0, 0.4)))
LAST = HandTarget(Pose(rotation_z(0.3) @ DOWN_ALONG_Y, np.array((0.51, 0.02, 0.03))), 0.08)


def body(position: Any, velocity: Any = STILL, rotation: Any = ALONG_X) -> BodyState:
    return BodyState(Pose(np.asarray(rotation), np.array(position)), np.array(velocity), np.zeros(3))


def seen(
    hand: Any = (0.5, 0.0, 0.13), at: Any = (0.5, 0.0, 0.033), v: Any = STILL, *, yaw: float = 0.0,
    bowl: Any = (0.3, 0.2, 0.02), bowl_v: Any = STILL,
) -> SceneState:  # fmt: skip
    """A scene in which the object, under either name, is at `at`."""
    thing = body(at, v)
    ee = Pose(rotation_z(math.radians(yaw)) @ DOWN_ALONG_Y, np.array(hand))
    objects = {"can": thing, "peach": thing, "bowl": body(bowl, bowl_v, np.eye(3))}
    return SceneState(
        time=0.0, q=np.zeros(7), dq=np.zeros(7), ee=ee, width=0.08, objects=objects, touching={}, on_table={}
    )


def remembered(state: State, **more: Any) -> Memory:
    return Memory(state=state, entered=1.0, initial=HOME, command=LAST, **more)


FAR = {"at": (0.7496, 0.0, 0.033)}  # the grasp is 30 mm high: 0.7502 m from the base
NEAR = {"at": (0.7490, 0.0, 0.033)}
HELD = {"hand": (0.5, 0.0, 0.033)}
LET_GO, KEPT = {"hand": (0.5, 0.0, 0.1335)}, {"hand": (0.5, 0.0, 0.1325)}
DRIFTS, GOES = (0.0, 0.0499, 0.0), (0.0, 0.0501, 0.0)
OVER_BOWL = {"hand": (0.3, 0.2, 0.12), "at": (0.3, 0.2, 0.11)}
AHEAD = OVER_BOWL | {"bowl_v": GOES}


@pytest.mark.parametrize(
    ("machine", "state", "t", "scene", "following"),
    [
        (LIFTS, State.INIT, 0.47, {}, State.INIT),
        (LIFTS, State.INIT, 0.48, {}, State.ABOVE),
        (LIFTS, State.INIT, 0.48, NEAR, State.ABOVE),
        (LIFTS, State.INIT, 0.48, FAR, State.INIT),
        (LIFTS, State.INIT, 0.48, {"at": (0.6, 0.0, 0.033), "v": (0.66, 0.0, 0.0)}, State.INIT),  # where it will be
        (LIFTS, State.RESET, 0.07, {}, State.RESET),
        (LIFTS, State.RESET, 0.08, {}, State.ABOVE),
        (LIFTS, State.RESET, 0.08, FAR, State.RESET),
        (LIFTS, State.ABOVE, 0.03, FAR, State.RESET),
        (LIFTS, State.ABOVE, 0.39, {}, State.ABOVE),
        (LIFTS, State.ABOVE, 0.40, {}, State.APPROACH),
        (LIFTS, State.ABOVE, 0.40, {"hand": (0.5099, 0.0, 0.5), "v": DRIFTS}, State.APPROACH),
        (LIFTS, State.ABOVE, 0.40, {"hand": (0.5101, 0.0, 0.1), "v": DRIFTS}, State.ABOVE),
        (LIFTS, State.ABOVE, 0.40, {"hand": (0.5, -0.0099, 0.5), "v": DRIFTS}, State.APPROACH),
        (LIFTS, State.ABOVE, 0.40, {"hand": (0.5, -0.0101, 0.1), "v": DRIFTS}, State.ABOVE),
        (LIFTS, State.ABOVE, 0.40, {"hand": (0.4, 0.2, 0.1425), "v": GOES}, State.APPROACH),
        (LIFTS, State.ABOVE, 0.40, {"hand": (0.5, 0.0, 0.1435), "v": GOES}, State.ABOVE),
        (LIFTS, State.ABOVE, 0.40, {"yaw": 14.9}, State.APPROACH),
        (LIFTS, State.ABOVE, 0.40, {"yaw": 15.1}, State.ABOVE),
        (LIFTS, State.ABOVE, 0.40, {"yaw": -15.1}, State.ABOVE),
        (LIFTS, State.APPROACH, 0.71, {}, State.APPROACH),
        (LIFTS, State.APPROACH, 0.72, FAR, State.GRASP),
        (LIFTS, State.GRASP, 0.71, {}, State.GRASP),
        (LIFTS, State.GRASP, 0.72, LET_GO, State.LIFT),
        (LIFTS, State.LIFT, 0.19, HELD, State.LIFT),
        (LIFTS, State.LIFT, 0.20, KEPT, State.TO_TARGET),
        (PLACES, State.LIFT, 0.20, KEPT, State.ABOVE_TARGET),
        (LIFTS, State.LIFT, 0.03, LET_GO, State.RESET),
        (LIFTS, State.TO_TARGET, 9.0, KEPT, State.TO_TARGET),
        (LIFTS, State.TO_TARGET, 0.03, LET_GO, State.RESET),
        (PLACES, State.ABOVE_TARGET, 0.39, OVER_BOWL, State.ABOVE_TARGET),
        (PLACES, State.ABOVE_TARGET, 0.40, OVER_BOWL, State.PLACE),
        (PLACES, State.ABOVE_TARGET, 0.40, OVER_BOWL | {"hand": (0.3, 0.2099, 0.2)}, State.PLACE),
        (PLACES, State.ABOVE_TARGET, 0.40, OVER_BOWL | {"hand": (0.3, 0.2101, 0.12)}, State.ABOVE_TARGET),
        (PLACES, State.ABOVE_TARGET, 0.40, AHEAD | {"hand": (0.3, 0.2199, 0.2)}, State.PLACE),
        (
            PLACES,
            State.ABOVE_TARGET,
            0.40,
            AHEAD | {"hand": (0.3, 0.2201, 0.2)},
            State.ABOVE_TARGET,
        ),
        (PLACES, State.ABOVE_TARGET, 0.03, LET_GO, State.RESET),
        (PLACES, State.PLACE, 0.39, OVER_BOWL, State.PLACE),
        (PLACES, State.PLACE, 0.40, LET_GO, State.TO_TARGET),
    ],
)
def test_a_row_of_the_table(
    machine: StateMachine, state: State, t: float, scene: dict[str, Any], following: State
) -> None:
    _, memory = machine.step(seen(**scene), 1.0 + t, remembered(state))
    assert memory.state is following
    assert memory.entered == (1.0 if following is state else 1.0 + t)


def test_a_moving_container_must_be_near_in_height_too() -> None:
    for z, following in ((0.2295, State.PLACE), (0.2305, State.ABOVE_TARGET)):
        scene = seen(hand=(0.3, 0.2, z), at=(0.3, 0.2, z), bowl_v=GOES)
        assert PLACES.step(scene, 1.4, remembered(State.ABOVE_TARGET))[1].state is following


def test_five_steps_in_a_row_outside_the_container_are_needed_to_try_again() -> None:
    beside, inside = seen(at=(0.3, 0.271, 0.05)), seen(at=(0.3, 0.269, 0.05))
    memory, states = remembered(State.TO_TARGET), []
    for scene in [beside] * 4 + [inside] + [beside] * 5:
        _, memory = PLACES.step(scene, 2.0, memory)
        states.append(memory.state)
    assert states == [State.TO_TARGET] * 9 + [State.RESET]


def command(machine: StateMachine, state: State, t: float = 0.03, **scene: Any) -> HandTarget:
    return machine.step(seen(**scene), 1.0 + t, remembered(state))[0]


def test_each_state_commands_what_its_row_says() -> None:
    moving = {"at": (0.5, 0.0, 0.033), "v": (0.0, 0.2, 0.0)}
    grasp = np.array((0.5, 0.046, 0.030))
    expected: list[tuple[StateMachine, State, dict[str, Any], Any, float]] = [
        (LIFTS, State.INIT, moving, HOME.position, 0.08),
        (LIFTS, State.RESET, moving, grasp + (0.0, 0.0, 0.1), 0.08),
        (LIFTS, State.RESET, FAR, HOME.position, 0.08),
        (LIFTS, State.ABOVE, moving, grasp + (0.0, 0.0, 0.1), 0.08),
        (LIFTS, State.GRASP, moving, LAST.pose.position, 0.0),
        (LIFTS, State.LIFT, moving, (0.5, 0.0, 0.133), 0.0),
        (LIFTS, State.TO_TARGET, moving, (0.3, 0.0, 0.3), 0.0),
        (PLACES, State.LIFT, moving, (0.5, 0.0, 0.133), 0.05),
        (PLACES, State.ABOVE_TARGET, moving, (0.3, 0.2, 0.22), 0.05),
        (PLACES, State.PLACE, moving, (0.3, 0.2, 0.12), 0.08),
        (PLACES, State.TO_TARGET, moving, (0.3, 0.0, 0.3), 0.08),
    ]
    for machine, state, scene, position, width in expected:
        target = command(machine, state, **scene)
        np.testing.assert_allclose(target.pose.position, position, atol=1e-3 if machine is PLACES else 1e-9)
        assert target.width == width, state
    np.testing.assert_array_equal(command(LIFTS, State.GRASP).pose.rotation, LAST.pose.rotation)
    np.testing.assert_array_equal(command(LIFTS, State.LIFT).pose.rotation, LAST.pose.rotation)
    np.testing.assert_array_equal(command(LIFTS, State.TO_TARGET).pose.rotation, FINAL.rotation)


def test_the_hand_comes_down_steadily_and_follows_the_prediction_but_no_longer_turns() -> None:
    memory, heights, rotations = remembered(State.APPROACH), [], []
    for k in range(1, 22):
        y = 0.01 * k
        turning = seen(at=(0.5, y, 0.033), v=(0.01 * k, 0.2, 0.0))
        target, memory = LIFTS.step(turning, 1.0 + k / 30, memory)
        rotations.append(target.pose.rotation)
        np.testing.assert_allclose(target.pose.position[:2], (0.5 + 0.0023 * k, y + 0.046))
        heights.append(target.pose.position[2])
    assert heights[0] == pytest.approx(0.130, abs=1e-3)
    assert heights[-1] == pytest.approx(0.030)
    assert -np.diff(heights).min() * 30 <= 0.25
    assert all(np.array_equal(rotation, rotations[0]) for rotation in rotations)


def test_objects_are_grasped_below_the_middle_if_table_and_palm_allow() -> None:
    def height(size: tuple[float, float, float], z: float) -> float:
        return float(Sight(Skill(object="can", size=size), seen(at=(0.5, 0.0, z))).grasp.position[2])

    assert height((0.045, 0.045, 0.045), 0.1) == pytest.approx(0.092)
    assert height((0.016, 0.016, 0.016), 0.1) == pytest.approx(0.1)
    assert height((0.020, 0.020, 0.020), 0.010) == pytest.approx(0.008)
    assert height((0.066, 0.066, 0.120), 0.1) == pytest.approx(0.097)  # the palm stays 3 mm above the can


def test_the_fingers_open_across_the_shorter_side_of_a_slow_object_and_along_the_velocity_of_a_fast_one() -> None:
    slanted = rotation_z(0.3) @ ALONG_X  # its shorter side is turned by 0.3 from the y axis

    def yaw(velocity: Any, skill: Skill = CAN, rotation: Any = slanted) -> float:
        return grasp_yaw(body((0.5, 0.0, 0.03), velocity, rotation), skill)

    assert yaw((0.0, 0.0999, 0.0)) == pytest.approx(0.3)
    assert yaw((0.0, 0.1001, 0.0)) == pytest.approx(0.0)
    assert yaw((-0.2, 0.2, 0.0)) == pytest.approx(math.pi / 4)
    assert yaw((0.2, -0.2, 0.0)) == pytest.approx(math.pi / 4), "a half turn is no other grasp"
    assert yaw((0.2, 0.0, 0.0)) == pytest.approx(0.3), "a can that slides along its axis"
    cube = Skill(object="block", size=SIZES["block"])
    assert abs(yaw((0.2, 1e-6, 0.0), cube)) == pytest.approx(math.pi / 2, abs=1e-5)
    car = Skill(object="toycar", size=SIZES["toycar"])
    assert abs(yaw((0.0, 0.5, 0.0), car, rotation_z(math.pi / 2))) == pytest.approx(math.pi / 2), "not along its length"
    assert yaw((0.0, 0.05, 0.0), PEACH) == 0.0


def test_it_knows_of_a_task_what_the_tasks_data_say() -> None:
    skills = {name: skill_for(get_task(name)) for name in SIZES}
    assert {name: skill.container for name, skill in skills.items() if skill.container} == {
        "peach": "bowl",
        "block": "pad",
    }
    assert [skill.object for skill in skills.values()] == list(SIZES)
    assert {name: skill.closed for name, skill in skills.items() if skill.closed} == {"peach": 0.05, "block": 0.035}


@pytest.mark.parametrize("name", ["lemon", "alarmclock", "pen", "peg"])
def test_a_task_outside_its_skills_is_refused_with_those_it_has(name: str) -> None:
    with pytest.raises(ValueError, match=rf"task '{name}'.* can, bottle, toycar, peach, block\."):
        make_generator("state_machine", get_task(name))


def test_the_command_refuses_such_a_task_before_any_work(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--task", "lemon", "--generator", "state_machine"]) == 2
    assert "supported tasks are can, bottle" in capsys.readouterr().err
    assert "state_machine" in GENERATORS
    assert "state_machine" in COLLECTING


def slow(name: str, *, least: float = 0.0) -> Task:
    """The task at 0.02 m/s at most, in fixed physics."""
    task = get_task(name).under(physics="fixed")
    ranges = dict(task.conditions.ranges) | {"speed": (least, 0.02)}
    return replace(task, conditions=replace(task.conditions, ranges=ranges))


def test_it_grasps_a_static_can_and_repeats_itself() -> None:
    task = slow("can")
    drawn = next(task.conditions.stream("val"))
    still = Condition("can", drawn.seed, 0.0, {**drawn.values, "speed": 0.0})
    generator = pickle.loads(pickle.dumps(make_generator("state_machine", task)))
    assert isinstance(generator, StateMachineGenerator)
    env = generator.make_env(task)
    episode, again = generator.attempt(env, still), generator.attempt(env, still)
    env.close()
    assert episode.success
    assert episode.generator == "state_machine"
    assert "phase" not in validate_steps(episode.steps)
    assert episode.content_hash() == again.content_hash()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["can", "bottle", "toycar"])
def test_it_grasps_what_hardly_moves(name: str) -> None:
    """A rival that fails where its authors' would succeed is our mistake."""
    task = slow(name, least=0.005)
    generator = StateMachineGenerator(task)
    env = generator.make_env(task)
    successes = [generator.attempt(env, condition).success for condition in islice(task.conditions.stream("val"), 20)]
    env.close()
    assert sum(successes) >= 18
