"""One run tells the rate under every threshold that is no higher than its own."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from dynaforge.evaluation import DgrReport, comparison_table, task_table
from dynaforge.evaluation.dgr import Count
from dynaforge.sim.loads import Loads
from dynaforge.sim.reflex import named_within


@dataclass(frozen=True)
class Made:
    success: bool
    loads: Loads | None
    difficulty: float = 0.5
    failure: str = ""
    block: int = 0


def report(*made: Made, thresholds: tuple[str, ...] = ("contact", "standard", "strict")) -> DgrReport:
    return DgrReport.from_attempts(made, difficulty_range=(0, 1), label="planner_only", thresholds=thresholds)


LIGHT = Made(True, Loads(peak_force=10.0, force=5.0, contact=0.1, standard=0.25, strict=0.5))
FIRM = Made(True, Loads(peak_force=70.0, force=50.0, contact=0.5, standard=1.25, strict=2.5))
HEAVY = Made(True, Loads(peak_force=300.0, force=150.0, contact=1.5, standard=3.75, strict=7.5))
LOST = Made(False, Loads(peak_force=900.0), failure="lost track")
BROKEN = Made(False, None, failure="exception")


def test_successes_are_counted_under_each_threshold_over_all_attempts() -> None:
    measured = report(LIGHT, FIRM, HEAVY, LOST, BROKEN)
    assert measured.total == Count(3, 5)
    assert dict(measured.under) == {"contact": Count(2, 5), "standard": Count(1, 5), "strict": Count(1, 5)}
    assert measured.peak_forces == pytest.approx((70.0, 254.0, 300.0))
    assert measured.lasting_forces == pytest.approx((50.0, 130.0, 150.0))
    assert DgrReport.from_dict(measured.to_dict()) == measured


def test_where_a_success_has_no_known_load_nothing_is_said_about_forces() -> None:
    measured = report(LIGHT, Made(True, None))
    assert not measured.under
    assert measured.peak_forces is measured.lasting_forces is None
    assert "reflex" not in comparison_table([measured])


def test_tables_show_the_rates_and_the_peak_forces() -> None:
    measured = report(LIGHT, FIRM, HEAVY, LOST, BROKEN)
    assert "contact 40.0%, standard 20.0%, strict 20.0%" in comparison_table([measured], width=120)
    rows = [line for line in task_table({"can": [measured]}).splitlines() if "planner_only" in line]
    assert all("40.0%" in row for row in rows)
    assert "50/130/150" in rows[0]
    assert "70/254/300" in rows[0]


def test_a_run_does_not_tell_what_a_softer_reflex_would_have_let_happen() -> None:
    assert named_within("off") == named_within("contact") == ("contact", "standard", "strict")
    assert named_within("standard") == ("standard", "strict")
    assert named_within("strict") == ("strict",)
    assert named_within(60) == ("standard", "strict")
    assert named_within(10) == ()
