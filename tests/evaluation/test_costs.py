"""What demonstrations cost: the paper's figures follow from its model, and measured costs from attempts."""

from __future__ import annotations

import math

import pytest

from dynaforge.evaluation.costs import PAPER_HUMAN_MINUTES, Cost, model_hours, paper_hours
from dynaforge.evaluation.dgr import Count
from dynaforge.evaluation.paper import PAPER_DGR


def test_the_papers_second_table_follows_from_its_first() -> None:
    hours = {name: round(value, 1) for name, value in paper_hours().items()}
    assert hours == {"state_machine": 26.9, "dmp": 25.4, "planner_only": 10.4, "residual": 6.5}
    assert dict(PAPER_HUMAN_MINUTES) == {"state_machine": 100, "dmp": 52.5, "planner_only": 75, "residual": 50}


def test_the_papers_first_table_has_its_means() -> None:
    """The means that the paper prints, so that a typing error in a cell is found."""
    means = {"state_machine": 29.07, "dmp": 13.41, "planner_only": 41.30, "residual": 78.37}
    for name, row in PAPER_DGR.items():
        cells = [cell[0] for cell in row.values() if cell is not None]
        assert sum(cells) / len(cells) == pytest.approx(means[name], abs=0.006)


def test_half_the_rate_takes_twice_the_collection() -> None:
    hours = model_hours({"a": [0.8, 0.4], "b": [0.4, 0.2]}, reference="a", collection=3.0, training=1.0)
    assert hours == pytest.approx({"a": 4.0, "b": 6.0})


def test_the_model_is_infinite_where_a_generator_never_succeeds() -> None:
    assert model_hours({"a": [0.5, 0.5], "b": [1.0, 0.0]}, reference="a")["b"] == math.inf


@pytest.mark.parametrize(
    ("rates", "complaint"),
    [
        ({"b": [0.5]}, "needs the rates of 'a'; given are b"),
        ({"a": [0.5], "b": [0.5, 0.5]}, "on the same tasks"),
        ({"a": []}, "on the same tasks, one at least"),
        ({"a": [0.0]}, "'a', which never succeeds"),
        ({"a": [50.0]}, "between 0 and 1"),
        ({"a": [math.nan]}, "between 0 and 1"),
    ],
)
def test_rates_that_the_model_cannot_use_are_refused(rates: dict[str, list[float]], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        model_hours(rates, reference="a")


def test_a_cost_by_hand() -> None:
    """800 successes at 40 % are 2000 attempts; at 1.8 CPU-seconds each, they take an hour."""
    cost = Cost(count=Count(40, 100), seconds=1.8, preparation=0.5)
    assert (cost.attempts, cost.collection, cost.total) == pytest.approx((2000.0, 1.0, 1.5))
    low, high = cost.attempts_interval
    assert low < cost.attempts < high
    assert 800 / high == pytest.approx(cost.count.interval[0])


def test_what_never_succeeds_has_no_cost() -> None:
    cost = Cost(count=Count(0, 100), seconds=1.8, preparation=0.5)
    assert cost.attempts == cost.collection == cost.total == cost.attempts_interval[1] == math.inf
    assert 800 < cost.attempts_interval[0] < math.inf
