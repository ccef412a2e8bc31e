"""Hidden physics: a condition fixes it, whatever was simulated before, and nobody is told."""

import hashlib
from dataclasses import replace
from itertools import islice

import gymnasium as gym
import numpy as np
import pytest

from dynaforge.envs.world import World
from dynaforge.sim import Condition, SimScene
from dynaforge.sim.hidden import HIDDEN, LEVELS, PHYSICS
from dynaforge.sim.probing import at_every_substep
from dynaforge.tasks import TASK_NAMES, get_task
from dynaforge.tasks.digest import digest_in_any_setting


def conditions_of(task, n=1):
    return {level: list(islice(task.under(physics=level).conditions.stream("val"), n)) for level in LEVELS}


def digest_of_motion(scene, condition, steps=40):
    """Return a digest of all that moves while the hand closes on its way down."""
    scene.reset(condition)
    digest = hashlib.sha256()
    for k in range(steps):
        state = scene.step(scene.robot.q_ready + 0.02 * np.sin(k / 10), 0.08 - 0.001 * k)
        digest.update(state.q.tobytes())
        for body in state.objects.values():
            digest.update(body.pose.position.tobytes() + body.velocity.tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize(
    "name", [n if n in ("can", "alarmclock") else pytest.param(n, marks=pytest.mark.slow) for n in TASK_NAMES]
)
def test_hidden_physics_of_earlier_episodes_leaves_no_trace(name):
    task = get_task(name)
    drawn = {level: conditions[0] for level, conditions in conditions_of(task).items()}
    scene, found = SimScene(task.scene), {level: set() for level in LEVELS}
    for level in ("fixed", "wide", "fixed", "varied", "wide", "varied"):
        found[level].add(digest_of_motion(scene, drawn[level]))
    scene.close()
    fresh = SimScene(task.scene)
    for level in LEVELS[::-1]:
        found[level].add(digest_of_motion(fresh, drawn[level]))
    fresh.close()
    assert all(len(digests) == 1 for digests in found.values())
    assert len(set.union(*found.values())) == len(LEVELS)


@pytest.mark.parametrize("field", ["object_friction", "finger_friction", "table_friction", "rolling_friction", "mass"])
def test_each_hidden_field_reaches_the_physics_and_is_taken_back(field):
    task = get_task("can")
    condition = next(task.under(physics="fixed").conditions.stream("val"))
    scene = SimScene(task.scene)
    bullet = scene._bullet
    client, robot = bullet.client, bullet.robot
    places = {
        "object_friction": (bullet.free["can"].body, -1, 1),
        "finger_friction": (robot.body, robot.fingers[0], 1),
        "table_friction": (bullet.table, -1, 1),
        "rolling_friction": (bullet.free["can"].body, -1, 6),
        "mass": (bullet.free["can"].body, -1, 0),
    }
    body, link, column = places[field]

    def now(hidden):
        scene.reset(Condition(condition.task, condition.seed, condition.difficulty, condition.values, hidden=hidden))
        return client.getDynamicsInfo(body, link)[column]

    nominal = now({})
    assert now({field: 1.25}) == pytest.approx(1.25 * nominal)
    assert now({}) == nominal
    scene.close()


def test_fine_physics_has_the_conditions_of_varied_physics_and_substeps_of_half_the_length():
    can = get_task("can")
    fine = can.under(physics="fine")
    assert next(fine.conditions.stream("val")) == next(can.conditions.stream("val"))
    assert digest_in_any_setting(fine) == digest_in_any_setting(can)
    substeps = {}
    for task in (can, fine):
        world, substeps[task.setting.physics] = World(task), 0
        world.reset(next(task.conditions.stream("val")))

        def count(physics=task.setting.physics):
            substeps[physics] += 1

        with at_every_substep(world.scene, after=count):
            world.scene.step(world.scene.robot.q_ready, 0.08)
        world.scene.close()
    assert substeps == {"varied": 8, "fine": 16}


def test_a_can_rolls_less_far_and_loses_speed_in_proportion_to_the_rolling_friction(scene):
    nominal = next(get_task("can").under(physics="fixed").conditions.stream("val"))

    def rolled(factor):
        """Return the distance (m) that the can rolls in a second, and the speed (m/s) that it loses."""
        first = scene.reset(replace(nominal, hidden={"rolling_friction": factor})).objects["can"]
        for _ in range(30):
            last = scene.step(scene.robot.q_ready, 0.08).objects["can"]
        speeds = [np.linalg.norm(body.velocity) for body in (first, last)]
        return np.linalg.norm(last.pose.position - first.pose.position), speeds[0] - speeds[1]

    far, lost = rolled(1.0)
    assert far > 0.7
    assert lost > 0.02
    for factor in (HIDDEN["rolling_friction"].varied[1], HIDDEN["rolling_friction"].wide[1]):
        less_far, more_lost = rolled(factor)
        assert more_lost == pytest.approx(factor * lost, rel=0.02)
        assert far - less_far == pytest.approx((more_lost - lost) / 2, rel=0.1)


@pytest.mark.parametrize("name", TASK_NAMES)
def test_visible_fields_do_not_depend_on_how_far_physics_varies(name):
    drawn = conditions_of(get_task(name), 3)
    for fixed, varied, wide in zip(*drawn.values(), strict=True):
        assert fixed.values == varied.values == wide.values
        assert fixed.seed == varied.seed == wide.seed
        assert not fixed.hidden
        assert varied.hidden.keys() == wide.hidden.keys() > {"object_friction", "joint_gain", "hand_delay"}
        assert "mass" not in varied.hidden


@pytest.mark.parametrize("field", [name for name in HIDDEN if name != "mass"])
def test_one_field_alone_may_be_wide(field):
    can = get_task("can")
    drawn = {level: next(can.under(physics=level).conditions.stream("val")).hidden for level in LEVELS}
    alone = next(can.under(physics=f"wide:{field}").conditions.stream("val")).hidden
    assert alone[field] == drawn["wide"][field] != drawn["varied"][field]
    assert {**alone, field: None} == {**drawn["varied"], field: None}


def test_every_hidden_field_may_be_widened_alone_where_it_varies():
    assert (*LEVELS, *(f"wide:{name}" for name in HIDDEN), "fine") == PHYSICS
    with pytest.raises(ValueError, match="in this task the mass is a field of its own"):
        get_task("can").under(physics="wide:mass")
    with pytest.raises(ValueError, match="Did you mean 'wide:hand_delay'"):
        get_task("can").under(physics="wide:hand_dely")


def test_ranges_are_nested_and_include_the_nominal_value():
    for field in HIDDEN.values():
        (low, high), (lowest, highest) = field.varied, field.wide
        assert lowest <= low <= field.nominal <= high <= highest
        assert highest - lowest >= 1.5 * (high - low)


def test_a_condition_without_hidden_fields_keeps_its_id_and_one_with_them_survives_json():
    plain = Condition("can", 1, 0.5, {"speed": 0.5})
    assert plain.to_dict() == {"task": "can", "seed": 1, "difficulty": 0.5, "values": {"speed": 0.5}}
    hidden = Condition("can", 1, 0.5, {"speed": 0.5}, hidden={"mass": 1.1})
    assert Condition.from_dict(hidden.to_dict()) == hidden
    assert hidden.id != plain.id


@pytest.mark.parametrize(
    ("hidden", "message"),
    [
        ({"object_fricton": 1.0}, "Did you mean 'object_friction'"),
        ({"object_friction": -0.1}, "at least 0"),
        ({"object_friction": float("nan")}, "finite number"),
        ("mass", "must be a mapping"),
    ],
)
def test_a_hidden_field_that_means_nothing_is_refused(hidden, message):
    with pytest.raises(ValueError, match=message):
        Condition("can", 1, 0.5, {"speed": 0.5}, hidden=hidden)


def test_a_hidden_field_beyond_the_range_of_the_setting_is_refused():
    task = get_task("can")
    wide = Condition.from_dict(
        next(task.conditions.stream("val")).to_dict()
        | {"hidden": {"object_friction": HIDDEN["object_friction"].wide[1]}}
    )
    task.under(physics="wide").conditions.validate(wide)
    for level in ("fixed", "varied"):
        with pytest.raises(ValueError, match=r"'object_friction' is 1\.5, outside"):
            task.under(physics=level).conditions.validate(wide)


@pytest.mark.parametrize("env_id", ["DynaForge/Can-v0", "DynaForge/CanTask-v0"])
def test_the_setting_of_an_env_is_chosen_where_it_is_made(env_id):
    env = gym.make(env_id, physics="fixed", reflex=40)
    assert env.unwrapped.task.setting == get_task("can").under(physics="fixed", reflex=40.0).setting
    env.close()
    with pytest.raises(ValueError, match="Did you mean 'wide'"):
        gym.make(env_id, physics="wid")
