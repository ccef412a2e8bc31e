from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from dynaforge.demos import Episode
from dynaforge.demos.episode_file import write_episode
from dynaforge.generators import make_generator
from dynaforge.generators.dmp import ALPHA, CENTRES, DECAY, STIFF_ALPHA, WIDTHS, MovementPrimitive, canonical, features
from dynaforge.generators.dmp_generator import DmpGenerator
from dynaforge.generators.dmp_segments import (
    Reference,
    ReferenceFrames,
    nearest_turn,
    pose_of,
    six_of,
    slowed,
    subtasks,
)
from dynaforge.generators.dmp_source import at_rest, read_source, record_source, speeds
from dynaforge.geometry import Array, Pose, matrix_from_rotvec, rotation_z
from dynaforge.sim import BodyState, Condition
from dynaforge.tasks import Task, get_task
from dynaforge.tasks.can import launch
from dynaforge.tasks.targets import DOWN_ALONG_X, HALF_TURN

CAN = get_task("can")
GOAL = np.array((0.5, -0.2, 0.1))
TIME = np.linspace(0.0, 1.0, 90)[:, None]
SHARE = TIME**3 * (10.0 - 15.0 * TIME + 6.0 * TIME**2)
PATH = SHARE * GOAL + 0.1 * np.sin(np.pi * SHARE) * (0.0, 1.0, -1.0)


@cache
def source(name: str) -> Episode:
    return record_source(get_task(name))


def slow_conditions(task: Task, most: float, n: int) -> list[Condition]:
    """Return conditions of a task at rest in which every speed is between 0 and `most`, in the direction drawn."""
    rng, conditions = np.random.default_rng(5), []
    for condition in islice(at_rest(task).conditions.stream("val"), n):
        values = dict(condition.values)
        for field in speeds(task):
            sign = 1.0 if task.conditions.ranges[field][0] >= 0.0 else np.sign(values[field])
            values[field] = float(sign * rng.uniform(0.0, most))
        conditions.append(Condition(task.name, condition.seed, values[task.conditions.difficulty], values))
    return conditions


def test_the_canonical_system_and_the_centres_are_those_of_the_script() -> None:
    """alpha_x = -ln 1e-4 = 9.2103; the middle centre of 100 would be 0.01; widths are 1 over a centred difference."""
    assert pytest.approx(9.210340371976184) == DECAY
    assert (ALPHA, STIFF_ALPHA, len(CENTRES)) == (25.0, 50.0, 100)
    np.testing.assert_allclose(CENTRES[[0, 33, 66, 99]], (1.0, 10 ** (-4 / 3), 10 ** (-8 / 3), 1e-4))
    assert WIDTHS[50] == pytest.approx(1.0 / ((CENTRES[51] - CENTRES[49]) / 2.0) ** 2)
    assert WIDTHS[0] == pytest.approx(1.0 / (CENTRES[1] - CENTRES[0]) ** 2)
    np.testing.assert_allclose(canonical(4), (1.0, 0.1, 0.01, 0.001))
    np.testing.assert_allclose(features(canonical(7)).sum(axis=1), canonical(7))


def rollout(primitive: MovementPrimitive, goals: Array) -> Array:
    return np.array([primitive.step(goal) for goal in goals])


def test_it_reproduces_its_path_while_the_goal_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until the gain doubles, within 6 mm of 0.5 m; from then on it only hurries to the same goal."""
    primitive = MovementPrimitive(PATH)
    moved = rollout(primitive, np.tile(GOAL, (90, 1)))
    assert np.abs(moved - PATH)[:46].max() < 0.006
    assert np.abs(moved - PATH).max() < 0.10
    assert np.linalg.norm(moved[-1] - GOAL) < 0.005
    monkeypatch.setattr("dynaforge.generators.dmp.STIFF_ALPHA", ALPHA)
    primitive.restart(PATH[0])
    assert np.abs(rollout(primitive, np.tile(GOAL, (90, 1))) - PATH).max() < 0.008


@pytest.mark.parametrize("n", [4, 15, 90])
def test_it_converges_to_a_goal_elsewhere_from_a_start_elsewhere_however_short_it_is(n: int) -> None:
    primitive = MovementPrimitive(PATH[:: 90 // n])
    primitive.restart(np.array((0.1, 0.2, 0.3)))
    other = GOAL + (0.2, -0.3, 0.05)
    moved = rollout(primitive, np.tile(other, (primitive.n_steps, 1)))
    assert np.linalg.norm(moved[-1] - other) < 0.02


def test_it_follows_a_goal_that_moves_and_trails_it_by_a_beta_th() -> None:
    """Of y'' = alpha (beta (g - y) - y') with g = v s the lag is v / beta, here a constant of 0.5 / 12.5 m."""
    flat = MovementPrimitive(np.zeros((400, 1)))
    goals = 0.5 * np.arange(400)[:, None] / 400
    assert goals[-1] - rollout(flat, goals)[-1] == pytest.approx(0.5 / (STIFF_ALPHA / 4), rel=0.05)
    primitive = MovementPrimitive(PATH)
    moving = GOAL + np.minimum(TIME, 0.7) * (0.2, 0.2, 0.0)
    assert np.linalg.norm(rollout(primitive, moving)[-1] - moving[-1]) < 0.01


def test_the_scale_is_that_of_the_path_whatever_the_goal() -> None:
    """A goal twice as far does not double the shape: the difference to the source is that of the goals alone."""
    primitive, plain = MovementPrimitive(PATH), MovementPrimitive(np.zeros_like(PATH))
    near = rollout(primitive, np.tile(GOAL, (90, 1)))
    primitive.restart(PATH[0])
    far = rollout(primitive, np.tile(2.0 * GOAL, (90, 1)))
    np.testing.assert_allclose(far - near, rollout(plain, np.tile(GOAL, (90, 1))), atol=1e-9)


def test_where_start_and_goal_of_the_path_are_equal_it_has_no_shape() -> None:
    moved = rollout(MovementPrimitive(np.sin(np.pi * np.round(TIME, 6)) * 0.0 + 0.3), np.full((90, 1), 0.3))
    np.testing.assert_allclose(moved, 0.3)


def test_a_path_that_is_too_short_and_a_step_too_many_are_refused() -> None:
    with pytest.raises(ValueError, match="3 or more"):
        MovementPrimitive(PATH[:2])
    with pytest.raises(ValueError, match="finite"):
        MovementPrimitive(np.full((9, 2), np.nan))
    primitive = MovementPrimitive(PATH[:3])
    rollout(primitive, np.tile(GOAL, (3, 1)))
    with pytest.raises(RuntimeError, match="ended after 3 steps"):
        primitive.step(GOAL)


def names(task: str) -> list[str]:
    phases = get_task(task).phases
    return [" ".join(phases[k].name for k in group) for group in subtasks(phases)]


def test_every_phase_is_a_segment_but_those_in_which_the_fingers_move() -> None:
    assert names("can") == ["pregrasp", "track", "descend close", "lift"]
    assert names("peach")[3:] == ["lift", "carry", "hover", "lower release", "settle"]
    assert names("alarmclock") == ["approach", "track", "press"]
    assert names("lemon") == ["approach", "wait close", "hold"]


def test_the_reference_of_a_phase_is_what_its_target_aims_at() -> None:
    def references(task: str) -> Mapping[str, Reference]:
        return {phase.name: Reference.of(phase) for phase in get_task(task).phases}

    assert references("can")["close"] == Reference("can", "half")
    assert references("can")["lift"] == Reference("")
    assert references("block")["descend"] == Reference("block", "quarter")
    assert references("block")["lower"] == Reference("pad", "all")
    assert references("pen")["close"] == Reference("pen", "all")
    assert references("alarmclock")["press"] == Reference("alarmclock", "all", sinks=True)
    assert references("lemon")["wait"] == Reference("ledge", "none", beside="lemon")


@pytest.mark.parametrize("roll", [0.0, 0.8, 1.57, 3.0])
def test_the_frame_of_a_can_at_rest_lies_across_its_axle_however_it_is_rolled(roll: float) -> None:
    space = at_rest(CAN).conditions
    values = {name: sum(ends) / 2 for name, ends in space.ranges.items()} | {"speed": 0.0, "roll": roll}
    start = launch(Condition("can", 0, 0.0, values))["can"]
    frames = ReferenceFrames()
    frames.push({"can": BodyState(start.pose, start.velocity, start.angular_velocity)})
    frames.enter(Reference("can", "half"))
    assert abs(frames.frame().rotation[:, 0] @ start.pose.rotation[:, 2]) < 1e-9


def test_the_frame_of_a_button_that_the_hand_presses_stays_as_high_as_it_was() -> None:
    frames = ReferenceFrames()
    for height in (0.08, 0.075):
        place = Pose(np.eye(3), np.array((0.5, 0.1, height)))
        frames.push({"button": BodyState(place, np.zeros(3), np.zeros(3))})
        if height == 0.08:
            frames.enter(Reference("button", sinks=True))
    np.testing.assert_array_equal(frames.frame().position, (0.5, 0.1, 0.08))


def test_of_grasps_that_a_symmetry_makes_equal_the_nearest_is_the_goal() -> None:
    relative = Pose(DOWN_ALONG_X, np.array((0.01, 0.0, 0.1)))
    frame = Pose(rotation_z(3.0), np.array((0.5, 0.0, 0.0)))
    goal = nearest_turn(frame, relative, "half", DOWN_ALONG_X)
    np.testing.assert_allclose(goal.rotation, (rotation_z(3.0) @ DOWN_ALONG_X) * HALF_TURN, atol=1e-12)
    np.testing.assert_allclose(goal.position, (0.5 + 0.01 * np.cos(3.0), 0.01 * np.sin(3.0), 0.1))
    anyhow = nearest_turn(frame, relative, "all", rotation_z(1.2) @ DOWN_ALONG_X)
    np.testing.assert_allclose(anyhow.rotation, rotation_z(1.2) @ DOWN_ALONG_X, atol=1e-12)
    np.testing.assert_allclose(anyhow.position, (0.5 + 0.01 * np.cos(1.2), 0.01 * np.sin(1.2), 0.1))
    kept = nearest_turn(frame, relative, "none", DOWN_ALONG_X)
    np.testing.assert_allclose(kept.rotation, frame.rotation @ DOWN_ALONG_X)


def test_six_numbers_stand_for_a_pose_and_do_not_jump_at_a_half_turn() -> None:
    pose = Pose(rotation_z(3.1) @ DOWN_ALONG_X, np.array((0.4, 0.1, 0.2)))
    six = six_of(pose)
    np.testing.assert_allclose(pose_of(six).rotation, pose.rotation, atol=1e-12)
    beyond = six_of(Pose(rotation_z(3.2) @ DOWN_ALONG_X, pose.position), six)
    np.testing.assert_allclose(beyond[3:] - six[3:], (0.0, 0.0, 0.1), atol=1e-9)


def test_a_slower_source_takes_longer_where_the_fingers_rest_and_no_longer_where_they_move() -> None:
    path, widths = np.tile(np.arange(6.0)[:, None], (1, 6)), np.array((0.08, 0.08, 0.08, 0.06, 0.04, 0.04))
    slower, opening = slowed(path, widths, 2.0)
    np.testing.assert_allclose(slower[:, 0], (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 4.5, 5.0))
    np.testing.assert_allclose(opening, (0.08, 0.08, 0.08, 0.08, 0.08, 0.06, 0.04, 0.04, 0.04))


def test_the_source_is_the_planners_on_an_object_at_rest_and_the_same_each_time() -> None:
    episode = source("can")
    assert episode.success
    assert episode.generator == "planner_only"
    assert episode.condition.values["speed"] == 0.0
    np.testing.assert_allclose(episode.steps["object/can/velocity"][0], 0.0, atol=1e-9)
    assert record_source(CAN.under(physics="wide", sensing="real")).content_hash() == episode.content_hash()


def test_a_lemon_cannot_rest_so_its_source_is_the_slowest_one_and_keeps_its_time() -> None:
    episode = source("lemon")
    assert episode.condition.values["speed"] == get_task("lemon").conditions.ranges["speed"][0]
    assert sum(len(segment.path) for segment in DmpGenerator(episode, get_task("lemon")).segments) == len(episode)


def test_a_task_that_the_planner_cannot_solve_is_refused_with_the_reasons() -> None:
    hopeless = replace(CAN, phases=(replace(CAN.phases[0], timeout=0.05), *CAN.phases[1:]))
    with pytest.raises(ValueError, match=r"no source demonstration of 'can'.*not reached"):
        record_source(hopeless)


@pytest.fixture(scope="module")
def grasped() -> Episode:
    """An attempt at a can that rests elsewhere than the source's."""
    generator = DmpGenerator(source("can"), at_rest(CAN))
    env = generator.make_env(at_rest(CAN))
    condition = slow_conditions(CAN, 0.0, 1)[0]
    episode = pickle.loads(pickle.dumps(generator)).attempt(env, condition)
    assert generator.attempt(env, condition).content_hash() == episode.content_hash()
    env.close()
    return episode


def test_it_grasps_a_can_that_rests_elsewhere(grasped: Episode) -> None:
    assert grasped.success
    assert grasped.generator == "dmp"
    start = grasped.steps["object/can/position"][0]
    assert np.linalg.norm(start - source("can").steps["object/can/position"][0]) > 0.05


def test_the_fingers_move_by_the_time_of_the_source(grasped: Episode) -> None:
    openings = np.concatenate([segment.widths for segment in DmpGenerator(source("can"), CAN).segments])
    n = min(len(openings), len(grasped))
    np.testing.assert_allclose(grasped.steps["requested_action"][:n, 7], openings[:n], atol=1e-6)


def test_after_the_last_step_of_the_source_the_command_stays(grasped: Episode) -> None:
    generator = DmpGenerator(source("can"), at_rest(CAN))
    env = generator.make_env(at_rest(CAN))
    far = slow_conditions(CAN, 0.0, 1)[0]
    far = replace(far, values={**far.values, "speed": 1.5, "lead": 1.3}, difficulty=1.5)
    env.reset(options={"condition": far})
    commands = generator._commands(env)
    n = sum(len(segment.path) for segment in generator.segments)
    actions = list(islice(commands, n + 5))
    assert all(np.array_equal(action, actions[n - 1]) for action in actions[n:])
    assert not np.array_equal(actions[n - 2], actions[n - 1])
    env.close()


def goals_after_the_grasp(**options: bool) -> tuple[Array, Array]:
    """Return the goal above the bowl, with the bowl at its place in the source and 10 cm beside it, shape (6,) each."""
    peach = get_task("peach")
    generator = DmpGenerator(source("peach"), peach, **options)
    index = next(k for k, segment in enumerate(generator.segments) if "carry" in segment.phases)
    start, goals = generator.segments[index].path[0], []
    for aside in (0.0, 0.1):
        frames = ReferenceFrames()
        place = Pose(np.eye(3), np.array((0.35, aside, 0.0)))
        frames.push({"bowl": BodyState(place, np.zeros(3), np.zeros(3))})
        frames.enter(generator.segments[index].reference)
        goals.append(generator._goal(index, frames, start, near=start))
    return goals[0], goals[1]


def test_the_place_goal_follows_the_bowl_unless_it_shall_not_as_in_the_released_code() -> None:
    here, there = goals_after_the_grasp()
    np.testing.assert_allclose((there - here)[:3], (0.0, 0.1, 0.0), atol=1e-9)
    here, there = goals_after_the_grasp(update_place_goal=False)
    np.testing.assert_array_equal(here, there)
    carry = next(s for s in DmpGenerator(source("peach"), get_task("peach")).segments if "carry" in s.phases)
    np.testing.assert_allclose(here, carry.path[-1], atol=1e-9)


def test_the_absolute_value_of_the_rotation_mirrors_a_goal_with_a_negative_component() -> None:
    generator = DmpGenerator(source("can"), CAN, absolute_rotation=True)
    segment = generator.segments[0]
    assert segment.T_object_hand is not None
    rotation = matrix_from_rotvec((2.0, -2.0, 0.1))
    generator.segments[0] = replace(segment, T_object_hand=Pose(rotation, np.zeros(3)))
    frames = ReferenceFrames()
    frames.push({"can": BodyState(Pose.identity(), np.zeros(3), np.zeros(3))})
    frames.enter(Reference("can", "half"))
    goal = generator._goal(0, frames, segment.path[0], near=six_of(Pose(rotation, np.zeros(3))))
    np.testing.assert_allclose(pose_of(goal).rotation, matrix_from_rotvec((2.0, 2.0, 0.1)), atol=1e-9)


def test_a_stored_source_is_read_and_one_of_another_definition_refused(tmp_path: Path) -> None:
    path = tmp_path / "source.h5"
    write_episode(path, source("can"))
    assert make_generator("dmp", CAN, source=path).policy_hash == make_generator("dmp", CAN).policy_hash
    with pytest.raises(ValueError, match="a recording of task 'can', not of 'peach'"):
        read_source(path, get_task("peach"))
    other = replace(CAN, phases=(replace(CAN.phases[0], timeout=2.9), *CAN.phases[1:]))
    with pytest.raises(ValueError, match="another definition of task 'can'"):
        read_source(path, other)
    with pytest.raises(ValueError, match="another definition of 'can'"):
        DmpGenerator(source("can"), CAN).make_env(other)


def test_a_source_is_a_success_of_the_planner(tmp_path: Path, grasped: Episode) -> None:
    meta = {**source("can").meta, **{"task_hash": source("can").meta["task_hash"]}}
    failed = Episode.from_header(
        {**source("can").header(), "success": False, "failure": "slipped", "checkpoint": 4, "meta": meta},
        dict(source("can").steps),
    )
    path = tmp_path / "failed.h5"
    write_episode(path, failed)
    with pytest.raises(ValueError, match=r"a failure \(slipped\)"):
        read_source(path, CAN)
    with pytest.raises(ValueError, match="runs through the phases"):
        DmpGenerator(grasped, CAN)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["can", "bottle", "toycar"])
def test_it_grasps_what_hardly_moves(name: str) -> None:
    """At 0.02 m/s and below, in fixed physics: 18 of 20, as its authors' would."""
    task = get_task(name)
    generator = DmpGenerator(source(name), at_rest(task))
    env = generator.make_env(at_rest(task))
    won = sum(generator.attempt(env, condition).success for condition in slow_conditions(task, 0.02, 20))
    env.close()
    assert won >= 18
