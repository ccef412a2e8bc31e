from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

from dynaforge.sim import Condition

CONDITION = Condition("can", 7, 0.5, {"speed": 0.5, "mass": 0.2})


def test_the_id_is_the_same_on_every_machine() -> None:
    assert CONDITION.id == "630932c63baea231"


def test_the_order_of_the_values_does_not_matter() -> None:
    other = Condition("can", 7, 0.5, {"mass": 0.2, "speed": 0.5})
    assert other == CONDITION
    assert other.id == CONDITION.id
    assert hash(other) == hash(CONDITION)


@pytest.mark.parametrize(
    "other",
    [
        Condition("can", np.int64(7), np.float64(0.5), {"speed": np.float64(0.5), "mass": 0.2}),  # type: ignore[arg-type]
        Condition("can", 7, 0.5, {"speed": 0.5, "mass": np.float64(0.2)}),
    ],
    ids=["numpy scalars", "numpy value"],
)
def test_equal_conditions_have_equal_ids_whatever_the_number_type(other: Condition) -> None:
    assert other == CONDITION
    assert other.id == CONDITION.id


def test_a_whole_number_as_difficulty_gives_the_same_id() -> None:
    assert Condition("can", 1, 1, {"speed": 1}).id == Condition("can", 1, 1.0, {"speed": 1.0}).id


def test_a_negative_zero_is_a_zero() -> None:
    zero = Condition("can", 1, 0.0, {"heading": 0.0})
    assert Condition("can", 1, -0.0, {"heading": -0.0}).id == zero.id


def test_every_field_changes_the_id() -> None:
    others = [
        Condition("pen", 7, 0.5, {"speed": 0.5, "mass": 0.2}),
        Condition("can", 8, 0.5, {"speed": 0.5, "mass": 0.2}),
        Condition("can", 7, 0.6, {"speed": 0.5, "mass": 0.2}),
        Condition("can", 7, 0.5, {"speed": 0.5, "mass": float(np.nextafter(0.2, 1.0))}),
    ]
    assert len({CONDITION.id, *(other.id for other in others)}) == 5


def test_json_and_pickle_keep_every_bit() -> None:
    exact = Condition("can", 2**31 - 1, 0.1 + 0.2, {"speed": 1 / 3})
    assert Condition.from_dict(json.loads(json.dumps(exact.to_dict()))) == exact
    assert pickle.loads(pickle.dumps(exact)) == exact
    assert pickle.loads(pickle.dumps(exact)).id == exact.id


def test_the_values_cannot_be_changed() -> None:
    given = {"speed": 0.5}
    condition = Condition("can", 7, 0.5, given)
    given["speed"] = 9.0
    assert condition.values["speed"] == 0.5
    with pytest.raises(TypeError):
        condition.values["speed"] = 9.0  # type: ignore[index]


def test_a_missing_field_is_named() -> None:
    with pytest.raises(ValueError, match=r"lacks \['seed'\]"):
        Condition.from_dict({"task": "can", "difficulty": 0.5, "values": {}})


def test_an_unknown_field_is_named() -> None:
    with pytest.raises(ValueError, match=r"unknown fields \['sede'\]"):
        Condition.from_dict({**CONDITION.to_dict(), "sede": 3})
