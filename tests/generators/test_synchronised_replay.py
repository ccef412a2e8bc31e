"""Synchronised replay: the object is at its end pose when the grasp closes, and everything says that it was driven."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import polynomial

from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset, Episode, audit
from dynaforge.demos.differences import differences
from dynaforge.demos.episode import Attempt
from dynaforge.demos.prescription import prescription_of
from dynaforge.demos.provenance import Provenance
from dynaforge.demos.replay import Replayer
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import PlannerOnly, SynchronisedReplay, make_generator
from dynaforge.generators.names import LEVELS, SLOWEST, Level
from dynaforge.generators.object_paths import Ending, draw_path, draw_speed, top_speed
from dynaforge.generators.repeat import Repeater
from dynaforge.generators.replay import between_fingers
from dynaforge.generators.static_scenes import SUPPORTED, static_scene
from dynaforge.geometry import Pose
from dynaforge.reports.card import Exported
from dynaforge.sim.prescribed import PrescribedMotion
from dynaforge.tasks import get_task
from dynaforge.tasks.targets import DOWN_ALONG_X, DOWN_ALONG_Y

CAN = get_task("can").under(physics="fixed")
CONDITION = next(CAN.conditions.stream("train"))
ENDING = Ending(position=np.array((0.5, 0.1, 0.03)), direction=2.0, duration=1.5)


def path(seed: int, level: Level, cap: float = 0.1, ending: Ending = ENDING) -> PrescribedMotion:
    """Draw a path with room on all sides; a motion refuses one with a gap, or that ends elsewhere."""
    rng = np.random.default_rng(seed)
    knots, pieces = draw_path(rng, level, ending, cap=cap, is_free=lambda points: True)
    end = tuple(ending.position.tolist())
    return PrescribedMotion(body="can", quat_wxyz=(1.0, 0.0, 0.0, 0.0), end=end, knots=knots, pieces=pieces)


@pytest.fixture(scope="module")
def env() -> Iterator[ResidualEnv]:
    env = SynchronisedReplay().make_env(CAN)
    yield env
    env.close()


@pytest.fixture(scope="module", params=LEVELS)
def episode(request: pytest.FixtureRequest, env: ResidualEnv) -> Episode:
    return SynchronisedReplay(level=request.param).attempt(env, CONDITION)


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("cap", [0.01, 0.02, 0.1, 1.5])
def test_every_path_ends_in_place_and_time_within_its_cap(level: Level, cap: float) -> None:
    for seed in range(20):
        motion = path(seed, level, cap)
        assert motion.duration == 1.5
        assert motion.position(1.5) == (0.5, 0.1, 0.03)
        np.testing.assert_allclose(motion.position(1.5 - 1e-9), motion.end, atol=1e-8)
        assert 0.0 < top_speed(motion.knots, motion.pieces) <= cap * (1.0 + 1e-9)
        assert {piece[2] for piece in motion.pieces} == {(0.03,)}, "the object keeps its height"


def test_level_1_is_a_line_at_the_drawn_speed() -> None:
    motion = path(3, 1)
    speed = draw_speed(np.random.default_rng(3), 0.1)
    ((x, y, _),) = motion.pieces
    np.testing.assert_allclose((x[1], y[1]), (speed * math.cos(2.0), speed * math.sin(2.0)))
    np.testing.assert_allclose((x[0], y[0]), (0.5 - 1.5 * x[1], 0.1 - 1.5 * y[1]))


def test_level_2_is_a_polynomial_of_degree_2_to_4() -> None:
    degrees = set()
    for seed in range(30):
        (piece,) = path(seed, 2).pieces
        degrees |= {len(polynomial.polytrim(np.array(axis), 1e-9)) - 1 for axis in piece[:2]}
    assert degrees == {2, 3, 4}, "through three to five points"


def test_level_3_has_two_or_three_lines_of_equal_duration_and_arrives_as_level_1_does() -> None:
    numbers = set()
    for seed in range(30):
        motion = path(seed, 3)
        numbers.add(len(motion.pieces))
        np.testing.assert_allclose(np.diff(motion.knots), 1.5 / len(motion.pieces))
        velocities = [np.array((x[1], y[1])) for x, y, _ in motion.pieces]
        assert all(len(axis) == 2 for piece in motion.pieces for axis in piece[:2])
        angles = [math.atan2(v[1], v[0]) for v in velocities]
        assert angles[-1] == pytest.approx(2.0)
        assert all(abs(math.remainder(a - b, math.tau)) <= math.pi / 3 + 1e-9 for a, b in pairwise(angles))
    assert numbers == {2, 3}


def test_speeds_are_normal_about_four_fifths_of_the_cap_and_clipped() -> None:
    rng = np.random.default_rng(0)
    speeds = np.array([draw_speed(rng, 0.1) for _ in range(4000)])
    assert speeds.min() == SLOWEST
    assert speeds.max() == 0.1
    # P(N(0.08, 0.0333^2) >= 0.1) = P(Z >= 0.6) = 0.274, and its median is 0.08.
    assert np.mean(speeds == 0.1) == pytest.approx(0.274, abs=0.03)
    assert np.median(speeds) == pytest.approx(0.08, abs=0.003)


@pytest.mark.parametrize("level", LEVELS)
def test_a_path_keeps_where_the_object_may_be(level: Level) -> None:
    scene = static_scene(CAN, CONDITION)
    for seed, duration in enumerate((3.0, 3.0, 3.0, 3.0, 400.0)):  # the last one is too long at any speed
        ending = replace(ENDING, position=scene.pose.position, duration=duration)
        rng = np.random.default_rng(seed)
        knots, pieces = draw_path(rng, level, ending, cap=2.0, is_free=scene.is_free)
        motion = replace(scene.standing("can"), knots=knots, pieces=pieces)
        assert scene.is_free(np.array([motion.position(t) for t in np.linspace(0.0, duration, 40)]))


@pytest.mark.parametrize(("rotation", "across"), [(DOWN_ALONG_X, math.pi / 2), (DOWN_ALONG_Y, 0.0)])
def test_the_object_comes_across_the_fingers_from_its_own_side(rotation: np.ndarray, across: float) -> None:
    hand = Pose(rotation, np.zeros(3))
    for sign in (0.0, math.pi):
        for off in (-0.5, 0.0, 1.2):
            found = between_fingers(hand, across + sign + off)
            assert math.remainder(found - across - sign, math.tau) == pytest.approx(0.0, abs=1e-9)


# ---------------------------------------------------------------- episodes


def test_the_object_is_at_its_end_pose_at_the_last_prescribed_step(episode: Episode) -> None:
    note, steps = prescription_of(episode), episode.steps
    assert note is not None
    last = round(note.until * 30)
    assert note.until == pytest.approx(note.motion.duration)
    assert steps["object/can/position"][last].tolist() == list(note.motion.end)
    assert not steps["object/can/velocity"][last].any()
    assert not steps["object/can/angular_velocity"][last].any()
    quats = steps["object/can/quat_wxyz"][: last + 1]
    np.testing.assert_allclose(np.abs(quats @ note.motion.quat_wxyz), 1.0, atol=1e-12)
    for k in range(last):
        np.testing.assert_allclose(steps["object/can/position"][k], note.motion.position(k / 30), atol=1e-9)
    phases = [episode.meta["phases"][k] for k in steps["phase"]]
    assert set(phases[:last]) == {"pregrasp", "track", "descend", "close"}
    assert phases[last] == "lift", "the path ends when the grasp is closed"


def test_the_end_is_where_the_object_is_grasped_at_rest(episode: Episode) -> None:
    note = prescription_of(episode)
    assert note is not None
    values = episode.condition.values
    assert note.motion.end == (values["cross_x"], values["cross_y"], pytest.approx(0.033))


def test_the_robot_replays_the_dry_run_to_the_bit(env: ResidualEnv) -> None:
    generator = SynchronisedReplay()
    standing = static_scene(CAN, CONDITION).standing("can")
    dry = generator._dry_run(env, CONDITION, standing)
    assert dry.failure is None
    steps = generator.attempt(env, CONDITION).steps
    for k, planned in enumerate(dry.actions):
        assert planned.sample is not None
        assert (steps["joint_reference"][k] == planned.sample.q).all()
        assert (steps["joint_velocity_reference"][k] == planned.sample.dq).all()


def test_a_condition_fixes_the_episode(env: ResidualEnv, episode: Episode) -> None:
    assert prescription_of(episode) is not None
    again = SynchronisedReplay.of(episode).attempt(env, CONDITION)
    assert again.content_hash() == episode.content_hash()


def test_the_planner_keeps_its_bits_after_a_replay(env: ResidualEnv) -> None:
    before = PlannerOnly().attempt(env, CONDITION)
    SynchronisedReplay(level=2).attempt(env, CONDITION)
    assert PlannerOnly().attempt(env, CONDITION).content_hash() == before.content_hash()
    assert before.dynamics == "free"
    assert "dynamics" not in before.header()


def test_released_at_contact_physics_takes_over_when_the_robot_touches_the_object(env: ResidualEnv) -> None:
    episode = SynchronisedReplay(release="contact").attempt(env, CONDITION)
    note = prescription_of(episode)
    assert note is not None
    assert 0.0 < note.until < note.motion.duration
    assert episode.meta["contact_time"] == pytest.approx(note.until, abs=1 / 30 + 1e-9)


@pytest.mark.parametrize("name", SUPPORTED)
def test_every_supported_task_is_attempted_on_its_path(name: str) -> None:
    generator, task = SynchronisedReplay(), get_task(name).under(physics="fixed")
    env = generator.make_env(task)
    episode = generator.attempt(env, next(task.conditions.stream("train")))
    env.close()
    note = prescription_of(episode)
    assert note is not None
    last = round(note.until * 30)
    assert episode.steps[f"object/{name}/position"][last].tolist() == list(note.motion.end)
    assert len(episode) > last, "the program goes on after the grasp"


# ---------------------------------------------------------------- marks


def test_the_episode_and_its_line_in_the_ledger_are_marked(episode: Episode) -> None:
    assert episode.meta["dynamics"] == "prescribed"
    assert Episode.from_header(episode.header(), dict(episode.steps)).dynamics == "prescribed"
    line = Attempt.of(episode)
    assert line.to_dict()["dynamics"] == "prescribed"
    assert Attempt.from_dict(line.to_dict()).dynamics == "prescribed"
    assert Exported.of(episode).dynamics == "prescribed"


def test_verify_makes_it_again_and_says_that_its_motion_is_prescribed(
    episode: Episode, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = DemonstrationDataset(tmp_path / "can", task="can", keep_failures=True)
    task_hash = episode.meta["task_hash"]
    dataset.note_source(episode.generator, Provenance("", task_hash, "", CAN.setting))
    dataset.add(episode)
    assert main(["verify", str(tmp_path / "can"), "--replay", "--audit"]) == 0
    assert "dynamics: prescribed in 1 of 1" in capsys.readouterr().out


def test_a_replayed_episode_repeats_its_physics(episode: Episode) -> None:
    replayer = Replayer(CAN)
    assert replayer.replay(episode).divergence is None
    assert audit.audit(episode, replayer=replayer) == []
    replayer.close()


def test_without_its_mark_it_is_found_out(env: ResidualEnv) -> None:
    """Speed without a cause is flagged, and neither the attempt nor its physics can be repeated."""
    episode = SynchronisedReplay(level=3, speed=1.0).attempt(env, CONDITION)
    bare = {k: v for k, v in episode.meta.items() if k not in ("dynamics", "prescribed")}
    unmarked = replace(episode, meta=bare)
    assert audit.audit(episode) == []
    assert any("J/kg with nothing near it" in flag.violation for flag in audit.audit(unmarked))
    repeater, replayer = Repeater(CAN), Replayer(CAN)
    assert differences(episode, repeater(episode)) == []
    assert differences(unmarked, repeater(unmarked)) != []
    assert replayer.replay(unmarked).divergence is not None
    repeater.close()
    replayer.close()


def test_a_free_episode_that_is_marked_is_found_out(env: ResidualEnv) -> None:
    free = PlannerOnly().attempt(env, CONDITION)
    note = SynchronisedReplay().attempt(env, CONDITION).meta
    marked = replace(free, meta={**free.meta, "dynamics": "prescribed", "prescribed": note["prescribed"]})
    assert any("off its prescribed path" in flag.violation for flag in audit.audit(marked))
    repeater = Repeater(CAN)
    assert differences(marked, repeater(marked)) != []
    for malformed in ({}, {"options": {}, "until": 1.0}, {**note["prescribed"], "options": {"speed": 9.0}}):
        with pytest.raises(ValueError, match=r"prescribed|Prescribed|speed"):
            repeater(replace(free, meta={**free.meta, "dynamics": "prescribed", "prescribed": malformed}))
    repeater.close()


def test_a_moved_object_is_off_its_path(episode: Episode) -> None:
    steps = {name: column.copy() for name, column in episode.steps.items()}
    steps["object/can/position"][10] += (0.0, 0.002, 0.0)
    (flag,) = audit.audit(replace(episode, steps=steps))
    assert "off its prescribed path" in flag.violation
    assert flag.step == 10


# ---------------------------------------------------------------- options


def test_options_are_part_of_the_name() -> None:
    assert SynchronisedReplay().name == "replay"
    assert SynchronisedReplay(level=3, release="contact", speed="task").name == "replay-level3-contact-task-speed"
    assert SynchronisedReplay(speed=0.02).name == "replay-0.02mps"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": 4}, "level"),
        ({"release": "never"}, "release"),
        ({"speed": "fast"}, "speed"),
        ({"speed": 0.009}, "at least 0.01"),
        ({"speed": 2.1}, "at most 2"),
        ({"speed": float("nan")}, "finite"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SynchronisedReplay(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["lemon", "alarmclock", "pen", "peg"])
def test_a_task_without_a_static_grasp_is_refused_with_those_that_have_one(name: str) -> None:
    with pytest.raises(ValueError, match="can, bottle, toycar, peach, block"):
        make_generator("replay", get_task(name))
    with pytest.raises(ValueError, match=name):
        SynchronisedReplay().make_env(get_task(name))


def test_collect_and_evaluate_take_it_with_its_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = ["--task", "can", "--workers", "1"]
    folder, out = tmp_path / "can", tmp_path / "out.json"
    assert main(["collect", *common, "--generator", "replay", "--demos", "1", "--out", str(folder)]) == 0
    assert DemonstrationDataset(folder).attempts()[0].dynamics == "prescribed"
    flags = ["--level", "2", "--release", "contact", "--object-speed", "task"]
    blocks = ["--seeds", "1", "--attempts", "1", "--out", str(out)]
    assert main(["evaluate", *common, "--generator", "replay", *flags, *blocks]) == 0
    assert "replay-level2-contact-task-speed" in out.read_text()
    assert main(["evaluate", *common, "--generator", "replay", "--object-speed", "3"]) == 2
    assert "0.01 to 2 m/s" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", ["can", "bottle", "toycar"])
def test_slow_objects_are_grasped(name: str, level: Level) -> None:
    """At 0.02 m/s at most, in fixed physics, nine of ten attempts at the grasp tasks succeed."""
    generator, task = SynchronisedReplay(level=level, speed=0.02), get_task(name).under(physics="fixed")
    env = generator.make_env(task)
    successes = [generator.attempt(env, c).success for c in islice(task.conditions.stream("train"), 20)]
    env.close()
    assert sum(successes) >= 18
