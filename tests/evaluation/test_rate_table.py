from __future__ import annotations

import math

import pytest

from dynaforge.evaluation import DgrReport
from dynaforge.evaluation.dgr import CountedAttempt
from dynaforge.evaluation.paper import PAPER_DGR
from dynaforge.evaluation.rate_table import Rate, RateTable


def report(*blocks: int, of: int = 100) -> DgrReport:
    """A report with so many successes in each block."""
    attempts = [
        CountedAttempt(0.5, k < successes, "" if k < successes else "slipped", block)
        for block, successes in enumerate(blocks)
        for k in range(of)
    ]
    return DgrReport.from_attempts(attempts, difficulty_range=(0.0, 1.0))


TABLE = RateTable(
    ("can", "pen", "peg"),
    {
        "planner": {"can": report(40, 50, 51), "pen": report(30, 30, 30), "peg": report(10, 20, 30)},
        "learned": {"can": report(80, 80, 80), "pen": report(60, 63, 66), "peg": report(20, 20, 20)},
        "grasper": {"can": report(47, 47, 47)},
        "nothing": {},
    },
)


def test_a_rate_is_that_of_the_blocks_with_the_spread_of_the_paper() -> None:
    rate = TABLE.rate("planner", "can")
    assert rate is not None
    # Mean of 40, 50, 51 is 47; squares 49 + 9 + 16 = 74, over three.
    assert rate.mean == pytest.approx(0.47)
    assert rate.std == pytest.approx(math.sqrt(74 / 3) / 100)
    assert TABLE.rate("grasper", "pen") is None


def test_the_spread_of_the_paper_has_the_number_of_seeds_below() -> None:
    """Of every three whole numbers out of 100 with the mean of a cell, some have its spread, in this convention."""
    for cells in PAPER_DGR.values():
        for shown, spread in filter(None, cells.values()):
            total = round(3 * shown)
            triples = ((a, b, total - a - b) for a in range(101) for b in range(a, 101) if b <= total - a - b <= 100)
            assert any(round(100 * Rate.of([k / 100 for k in triple]).std, 2) == spread for triple in triples)


def test_the_mean_is_over_the_tasks_of_a_generator_and_its_spread_that_of_the_blocks_means() -> None:
    mean = TABLE.mean("planner")
    assert mean is not None
    # Blocks: (40 + 30 + 10) / 3 = 80/3, 100/3, 111/3; mean 97/3.
    assert mean.mean == pytest.approx(0.97 / 3)
    assert mean.std == pytest.approx(math.sqrt((17**2 + 3**2 + 14**2) / 3) / 300)
    assert TABLE.mean("grasper") == TABLE.rate("grasper", "can")
    assert TABLE.mean("nothing") is None


def test_the_paper_s_means_are_those_of_its_supported_tasks() -> None:
    expected = {"state_machine": 29.07, "dmp": 13.41, "planner_only": 41.30, "residual": 78.37}
    for row, expected_mean in expected.items():
        cells = [cell for cell in PAPER_DGR[row].values() if cell is not None]
        reports = {str(k): report(round(3 * shown), of=300) for k, (shown, _) in enumerate(cells)}
        table = RateTable(tuple(reports), {row: reports})
        mean = table.mean(row)
        assert mean is not None
        assert mean.shown == expected_mean


def test_the_best_and_the_second_are_those_shown_and_several_may_share_a_place() -> None:
    assert TABLE.best("can") == ("learned",)
    assert TABLE.best("can", 1) == ("planner", "grasper")  # 47.00 both
    assert TABLE.best("can", 2) == ()
    assert TABLE.best("peg") == ("planner", "learned")
    assert TABLE.best("peg", 1) == ()
    assert TABLE.best(None) == ("learned",)
    assert TABLE.best(None, 1) == ("grasper",)


def test_the_gain_is_the_difference_of_what_is_shown() -> None:
    assert TABLE.gain("learned", "planner", "can") == 33.0
    assert TABLE.gain("learned", "planner", "pen") == 33.0
    assert TABLE.gain("learned", "planner", "peg") == 0.0
    assert TABLE.gain("grasper", "planner", "pen") is None
    # 54.33 less 32.33, the means as they are shown
    assert TABLE.gain("learned", "planner", None) == 22.0
    assert TABLE.gain("grasper", "planner", None) is None  # other tasks


def test_a_generator_that_ended_early_has_a_mean_without_spread() -> None:
    table = RateTable(("can", "pen"), {"a": {"can": report(50, 60), "pen": report(20)}})
    assert table.mean("a") == Rate(pytest.approx(0.375), 0.0)
