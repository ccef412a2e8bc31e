from __future__ import annotations

import json

import pytest

from dynaforge.demos import Attempt
from dynaforge.evaluation import DgrReport, comparison_table, paired_difference, task_table
from dynaforge.evaluation.dgr import Count, CountedAttempt
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome


def trials() -> list[CountedAttempt]:
    outcomes = [(0.0, True, 0), (0.1, True, 0), (0.9, False, 1), (1.0, False, 1), (0.5, True, 1), (0.45, False, 0)]
    return [
        CountedAttempt(d, ok, "" if ok else ("dropped" if d > 0.8 else "timeout"), block) for d, ok, block in outcomes
    ]


def test_every_attempt_is_in_the_denominator():
    report = DgrReport.from_attempts(trials(), difficulty_range=(0.0, 1.0))
    assert report.total == Count(3, 6)
    assert report.blocks == (Count(2, 3), Count(1, 3))
    assert report.mean == pytest.approx(0.5)
    assert report.std == pytest.approx((1 / 3) / 2**0.5)
    assert sum(one.n for one in report.bins) == 6


def test_bins_divide_the_range_equally_and_include_its_ends():
    report = DgrReport.from_attempts(trials(), difficulty_range=(0.0, 1.0))
    assert [one.n for one in report.bins] == [2, 0, 0, 1, 1, 0, 0, 2]
    assert report.edges == tuple(i / 8 for i in range(9))
    with pytest.raises(ValueError, match=r"0\.9 lies outside"):
        DgrReport.from_attempts(trials(), difficulty_range=(0.0, 0.8))


def test_failures_are_ranked_and_add_up():
    report = DgrReport.from_attempts(trials(), difficulty_range=(0.0, 1.0))
    assert list(report.failures.items()) == [("dropped", 2), ("timeout", 1)]
    assert sum(report.failures.values()) == report.n - report.total.successes


def test_report_survives_json():
    report = DgrReport.from_attempts(trials(), difficulty_range=(0.0, 1.0), label="planner only")
    assert DgrReport.from_dict(json.loads(json.dumps(report.to_dict(), allow_nan=False))) == report
    single = DgrReport.from_attempts(trials()[:2], difficulty_range=(0.0, 1.0))
    assert single.std != single.std
    json.dumps(single.to_dict()["derived"]["std"], allow_nan=False)
    with pytest.raises(ValueError, match="Not a DGR report"):
        DgrReport.from_dict({"label": "x"})


def test_attempts_of_a_ledger_can_be_counted():
    outcome = Outcome(success=False, checkpoint=0, failure="no plan", phase="approach")
    attempt = Attempt(condition=Condition("can", 1, 0.3, {}), generator="planner", outcome=outcome, duration=0.0)
    report = DgrReport.from_attempts([attempt], difficulty_range=(0.0, 1.0))
    assert report.failures == {"no plan": 1}


def test_tables_show_rates_intervals_and_gain():
    report = DgrReport.from_attempts(trials(), difficulty_range=(0.0, 1.0), label="planner only")
    table = report.table()
    assert "50.0%" in table
    assert "18.8% - 81.2%" in table
    assert "2  dropped" in table
    text = comparison_table([report, report], paired=paired_difference([0, 0, 1], [1, 1, 1]))
    assert "planner only" in text
    assert "+66.7 points" in text
    assert max(map(len, text.splitlines()[:-1])) <= 80


def test_no_attempts_make_no_report():
    with pytest.raises(ValueError, match="needs attempts"):
        DgrReport.from_attempts([], difficulty_range=(0.0, 1.0))


def test_the_table_over_tasks_ends_with_the_mean_of_the_tasks() -> None:
    """Half of one task and all of another: three quarters, however many attempts each had."""
    half = DgrReport.from_attempts(
        [CountedAttempt(0.1, True), CountedAttempt(0.9, False, "slipped")], difficulty_range=(0, 1), label="p"
    )
    full = DgrReport.from_attempts([CountedAttempt(0.1, True)] * 6, difficulty_range=(0, 1), label="p")
    *_, last = [line for line in task_table({"can": [half], "peg": [full]}).splitlines() if "mean" in line]
    assert "75.0%" in last
    assert " 8 " in last
