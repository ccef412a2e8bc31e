from __future__ import annotations

import itertools
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from dynaforge.sim import Condition
from dynaforge.tasks import STREAMS, TASK_NAMES, ConditionSpace, get_task

SPACES = [get_task(name).conditions for name in TASK_NAMES]
TOY = ConditionSpace("toy", "speed", {"speed": (0.0, 8.0), "mass": (1.0, 2.0)})


def first(space: ConditionSpace, stream: str, block: int = 0, *, n: int = 40, n_strata: int | None = None):
    return list(itertools.islice(space.stream(stream, block, n_strata=n_strata), n))


def changed(condition: Condition, **values: float) -> Condition:
    return replace(condition, values={**condition.values, **values})


@pytest.mark.parametrize("space", SPACES, ids=TASK_NAMES)
@pytest.mark.parametrize("n_strata", [1, 8, 16])
def test_a_stratified_draw_falls_into_its_stratum(space: ConditionSpace, n_strata: int) -> None:
    rng = np.random.default_rng(0)
    edges = np.linspace(*space.difficulty_range, n_strata + 1)
    for stratum in range(n_strata):
        for _ in range(20):
            condition = space.draw(rng, stratum, n_strata)
            assert edges[stratum] - 1e-12 <= condition.difficulty <= edges[stratum + 1] + 1e-12
            assert space.validate(condition) is condition
            assert space.stratum(condition.difficulty, n_strata) == stratum


def test_a_stratum_is_the_numbered_part_of_the_range() -> None:
    """Stratum 3 of 4 over 0 to 8 m/s is 6 to 8 m/s."""
    rng = np.random.default_rng(1)
    drawn = [TOY.draw(rng, 3, 4).difficulty for _ in range(200)]
    assert 6.0 <= min(drawn) < 6.1
    assert 7.9 < max(drawn) <= 8.0
    assert [TOY.stratum(d, 4) for d in (0.0, 1.9, 2.0, 5.9, 8.0)] == [0, 0, 1, 2, 3]


def test_draws_without_a_stratum_fill_the_whole_range_evenly() -> None:
    rng = np.random.default_rng(2)
    speeds = [TOY.draw(rng).difficulty for _ in range(800)]
    counts, _ = np.histogram(speeds, 8, (0.0, 8.0))
    assert counts.min() > 60


def test_the_stratum_shifts_nothing_but_the_difficulty() -> None:
    free, bound = TOY.draw(np.random.default_rng(3)), TOY.draw(np.random.default_rng(3), 5, 8)
    assert free.values["mass"] == bound.values["mass"]
    assert free.seed == bound.seed


@pytest.mark.parametrize("stratum", [-1, 4])
def test_a_stratum_that_does_not_exist_is_refused(stratum: int) -> None:
    with pytest.raises(ValueError, match=f"Stratum {stratum} does not exist among 4"):
        TOY.draw(np.random.default_rng(0), stratum, 4)


@pytest.mark.parametrize("space", SPACES, ids=TASK_NAMES)
def test_streams_and_blocks_share_no_condition(space: ConditionSpace) -> None:
    ids = [c.id for stream in STREAMS for block in range(3) for c in first(space, stream, block)]
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("space", SPACES, ids=TASK_NAMES)
def test_a_stream_can_be_had_again(space: ConditionSpace) -> None:
    assert first(space, "val", 1) == first(pickle.loads(pickle.dumps(space)), "val", 1)


def test_a_stream_is_the_same_in_every_process() -> None:
    """Pinned: whoever changes how conditions are drawn makes every stored result unrepeatable."""
    assert [c.id for c in first(TOY, "test", 2, n=3)] == ["1027fa7c66918238", "f647f7d6fb8a29a9", "a788818613ecb1e0"]


def test_a_stratified_stream_takes_the_strata_in_turn() -> None:
    drawn = first(TOY, "train", n=16, n_strata=8)
    assert [math.floor(c.difficulty) for c in drawn] == [*range(8), *range(8)]


def test_an_unknown_stream_is_refused() -> None:
    with pytest.raises(ValueError, match=r"No condition stream 'tset'; known are train, val, test\."):
        next(TOY.stream("tset"))


@pytest.mark.parametrize("space", SPACES, ids=TASK_NAMES)
def test_validation_names_the_field(space: ConditionSpace) -> None:
    good = first(space, "train", n=1)[0]
    for field, (low, high) in space.ranges.items():
        for value in (low - 0.01, high + 0.01, math.nan, math.inf):
            bad = changed(good, **{field: value})
            bad = replace(bad, difficulty=bad.values[space.difficulty])
            with pytest.raises(ValueError, match=f"Condition field '{field}' is "):
                space.validate(bad)
        lacking = {name: value for name, value in good.values.items() if name != field}
        with pytest.raises(ValueError, match=rf"lacks \['{field}'\]"):
            space.validate(replace(good, values=lacking))
    with pytest.raises(ValueError, match=r"unknown fields \['spede'\]"):
        space.validate(changed(good, spede=1.0))
    with pytest.raises(ValueError, match="belongs to task 'other'"):
        space.validate(replace(good, task="other"))
    with pytest.raises(ValueError, match="difficulty"):
        space.validate(replace(good, difficulty=good.difficulty + 0.1))
    for edge in (0, 1):
        ends = {field: ends[edge] for field, ends in space.ranges.items()}
        assert space.validate(Condition(space.task, 0, ends[space.difficulty], ends))


def test_reset_kwargs_are_what_reset_takes() -> None:
    condition = TOY.draw(np.random.default_rng(0))
    assert TOY.reset_kwargs(condition) == {"options": {"condition": condition}}


@pytest.mark.parametrize("space", SPACES, ids=TASK_NAMES)
def test_a_condition_space_survives_pickling(space: ConditionSpace) -> None:
    assert pickle.loads(pickle.dumps(space)) == space


def test_units_are_those_of_fields_and_travel_along() -> None:
    space = ConditionSpace("toy", "speed", {"speed": (0.0, 8.0)}, units={"speed": "m/s"})
    assert pickle.loads(pickle.dumps(space)).units == {"speed": "m/s"}
    with pytest.raises(ValueError, match=r"Units are given for \['sped'\].*the fields are \['speed'\]"):
        replace(space, units={"sped": "m/s"})


def test_every_difficulty_of_the_package_has_a_unit() -> None:
    assert all(space.units[space.difficulty] for space in SPACES)


def test_the_speed_is_the_difficulty_if_that_is_one_or_else_the_only_speed() -> None:
    assert [space.speed for space in SPACES] == ["speed"] * len(SPACES)
    ranges = {"angle": (0.0, 1.0), "belt": (0.0, 2.0), "bowl": (0.0, 3.0)}
    for difficulty, units, speed in (
        ("angle", {}, None),
        ("angle", {"belt": "m/s", "angle": "rad"}, "belt"),
        ("angle", {"belt": "m/s", "bowl": "m/s"}, None),
        ("bowl", {"belt": "m/s", "bowl": "m/s"}, "bowl"),
        ("bowl", {"belt": "m/s", "bowl": "mm"}, "belt"),
    ):
        assert ConditionSpace("toy", difficulty, ranges, units=units).speed == speed
