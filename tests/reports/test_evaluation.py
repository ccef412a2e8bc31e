from __future__ import annotations

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from dynaforge.demos import Attempt
from dynaforge.reports.evaluation import BINS, by_generator, gains_over_first, reports_of, write_evaluation
from dynaforge.tasks import Outcome, get_task

CAN = get_task("can")


def attempts(generator: str, success: np.ndarray, *, n_strata: int | None = BINS) -> list[Attempt]:
    """One attempt for each entry of `success`, on conditions that take the difficulty bins in turn."""
    conditions = islice(CAN.conditions.stream("val", n_strata=n_strata), len(success))
    return [
        Attempt(
            condition=condition,
            generator=generator,
            outcome=Outcome(success=True, checkpoint=5)
            if ok
            else Outcome(success=False, checkpoint=0, failure="slipped"),
            duration=1.0,
        )
        for condition, ok in zip(conditions, success, strict=True)
    ]


def test_a_gain_says_in_which_bins_it_is_worse() -> None:
    before = np.ones((20, BINS), bool)
    after = before.copy()
    after[:, 2] = False
    measured = {"planner_only": attempts("planner_only", before.ravel()), "new": attempts("new", after.ravel())}
    (gain,) = gains_over_first(CAN, measured)
    assert gain.worse_bins == (2,)
    first, second = gain.text.splitlines()
    assert first.startswith("new against planner_only: paired gain -12.5 points")
    assert "of 160 conditions, 0 succeed only with it and 20 only without it" in first
    assert second == "worse in difficulty bins 3 (1 to 8, easiest first)"
    assert gain.to_dict()["no_bin_lost"] == {"holds": False, "lost": [2]}
    (same,) = gains_over_first(CAN, dict.fromkeys(("a", "b"), measured["new"]))
    assert same.text.splitlines()[1] == "worse in none of 8 difficulty bins"


def test_bins_are_not_compared_where_the_conditions_do_not_take_them_in_turn() -> None:
    success = np.arange(16) % 3 > 0
    measured = {name: attempts(name, success, n_strata=None) for name in ("planner_only", "new")}
    (gain,) = gains_over_first(CAN, measured)
    assert gain.worse_bins is None
    assert "no_bin_lost" not in gain.to_dict()
    assert len(gain.text.splitlines()) == 1


def test_attempts_are_grouped_by_their_generator() -> None:
    made = [*attempts("b", np.ones(2, bool)), *attempts("a", np.zeros(3, bool))]
    rates = {report.label: (report.total.successes, report.n) for report in reports_of(CAN, by_generator(made))}
    assert rates == {"a": (0, 3), "b": (2, 2)}
    assert list(rates) == ["a", "b"]


def test_an_evaluation_stores_the_processor_time_of_every_attempt(tmp_path: Path) -> None:
    made = [replace(attempt, cpu_seconds=0.5 + k) for k, attempt in enumerate(attempts("a", np.ones(2, bool)))]
    measured = {"a": [*made, *attempts("a", np.ones(1, bool))]}
    path = tmp_path / "evaluation.json"
    write_evaluation(path, CAN, measured, reports=reports_of(CAN, measured), gains=[], policies={}, command="")
    assert json.loads(path.read_text())["cpu_seconds"] == {"a": [0.5, 1.5, None]}


def test_a_gain_of_a_comparison_that_ended_early_says_where_and_compares_what_both_attempted() -> None:
    before, after = np.zeros(48, bool), np.ones(11, bool)
    measured = {"planner_only": attempts("planner_only", before), "new": attempts("new", after)}
    (gain,) = gains_over_first(CAN, measured, sequential=True)
    assert gain.paired.n == 11
    assert gain.worse_bins is None
    assert gain.ended is not None
    assert (gain.ended.n, gain.ended.available, gain.ended.decided) == (8, 48, True)  # as the test of it works out
    assert (
        "decided after 8 of 48 conditions (anytime-valid test, level 5 %), 83 % saved; difference 95 % [+" in gain.text
    )
    assert gain.to_dict()["sequential"]["n"] == 8
    (fixed,) = gains_over_first(CAN, measured)
    assert fixed.ended is None
    assert "sequential" not in fixed.to_dict()
