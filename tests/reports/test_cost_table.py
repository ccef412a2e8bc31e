"""The table of costs, and what it is read from."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from dynaforge.demos import Attempt, DamagedFileError
from dynaforge.evaluation.costs import PAPER_TASKS, Cost
from dynaforge.evaluation.dgr import Count
from dynaforge.evaluation.paper import PAPER_DGR
from dynaforge.reports.costs import CostTable, write_costs
from dynaforge.reports.evaluation import reports_of, write_evaluation
from dynaforge.reports.stored_evaluation import read_evaluations
from dynaforge.tasks import Outcome, Task, get_task
from dynaforge.tasks.digest import task_digest

CAN = get_task("can")
COSTS = {
    ("planner_only", "can"): Cost(count=Count(20, 100), seconds=0.9),  # 4000 attempts, one hour
    ("planner_only", "peach"): Cost(count=Count(0, 100), seconds=0.9),
    ("residual", "can"): Cost(count=Count(80, 100), seconds=1.8, preparation=0.5),  # 1000 attempts, half an hour
    ("residual", "peach"): Cost(count=Count(40, 100), seconds=0.9, preparation=1.5),  # 2000 attempts, half an hour
    ("state_machine", "can"): Cost(count=Count(40, 100), seconds=0.9),
}
TABLE = CostTable(
    tasks=("can", "peach"),
    generators=("planner_only", "residual", "state_machine"),
    costs=COSTS,
    missing={("state_machine", "peach"): "It lacks the skill."},
)


def test_a_pair_costs_preparation_and_collection() -> None:
    rows = {row[:2]: row[2:] for row in TABLE.pair_rows()}
    dgr, seconds, attempts, _, *hours = rows["can", "residual"]
    assert (dgr, seconds, attempts, *hours) == ("80.0%", "1.80", "1,000", "0.50", "0.50", "1.00")


def test_what_never_succeeds_or_is_not_supported_has_no_figure() -> None:
    rows = {row[:2]: row[2:] for row in TABLE.pair_rows()}
    assert rows["peach", "planner_only"] == ("0.0%", "0.90", "never in 100", "over 21,625", "0.00", "never", "never")
    assert rows["peach", "state_machine"] == ("N/A", "", "", "", "", "", "")
    totals = {row[0]: row[1:] for row in TABLE.total_rows()}
    assert totals["planner_only"] == ("never", "0.00", "never", "never", "never", "-")
    assert totals["state_machine"] == ("N/A", "N/A", "N/A", "N/A", "-", "-")
    stored = TABLE.to_dict()
    assert json.loads(json.dumps(stored, allow_nan=False)) == stored
    assert stored["totals"]["planner_only"]["hours"] is None
    assert stored["totals"]["state_machine"]["hours"] is None
    assert len(stored["pairs"]) == len(COSTS)
    assert stored["not_available"] == [{"task": "peach", "generator": "state_machine", "reason": "It lacks the skill."}]
    assert "state_machine on peach: It lacks the skill." in TABLE.text()


def test_sums_are_over_the_tasks_and_the_model_is_scaled_by_the_residual() -> None:
    totals = {row[0]: row[1:] for row in TABLE.total_rows()}
    assert totals["residual"] == ("3,000", "2.00", "1.00", "3.00", "6.50", "-")
    assert TABLE.to_dict()["totals"]["residual"]["hours"] == pytest.approx(3.0)


def test_with_the_papers_rates_the_model_gives_the_papers_hours_beside_it() -> None:
    costs = {
        (name, task): Cost(count=Count(round(cell[0] * 3), 300), seconds=1.0)
        for name, row in PAPER_DGR.items()
        for task in PAPER_TASKS
        if (cell := row[task]) is not None
    }
    table = CostTable(tasks=PAPER_TASKS, generators=tuple(PAPER_DGR), costs=costs)
    hours = {row[0]: row[-2:] for row in table.total_rows()}
    assert {name: round(float(model), 1) for name, (model, _) in hours.items()} == {
        "state_machine": 26.9,
        "dmp": 25.4,
        "planner_only": 10.4,
        "residual": 6.5,
    }
    for model, paper in hours.values():
        assert float(model) == pytest.approx(float(paper), abs=0.05)


def test_a_short_preparation_is_told_from_none() -> None:
    for hours, shown in ((0.0, "0.00"), (2e-5, "0.00"), (3e-3, "< 0.01"), (0.014, "0.01")):
        cost = replace(COSTS["planner_only", "can"], preparation=hours)
        table = CostTable(tasks=("can",), generators=("planner_only",), costs={("planner_only", "can"): cost})
        assert table.pair_rows()[0][6] == shown


def test_without_the_reference_the_model_is_silent() -> None:
    table = replace(TABLE, generators=("planner_only",))
    assert table.model() == {}
    assert table.total_rows()[0][-2:] == ("-", "-")


def test_the_table_is_written_in_three_forms(tmp_path: Path) -> None:
    paths = write_costs(tmp_path, TABLE, command="dynaforge table2", origin={"training": "runs/compare"})
    assert [path.name for path in paths] == ["table2.md", "table2.tex", "table2.json"]
    markdown, latex, data = (path.read_text() for path in paths)
    assert "| residual | 3,000 | 2.00 | 1.00 | 3.00 | 6.50 | - |" in markdown
    assert r"state\_machine & N/A" in latex
    assert latex.count("&") == 6 * 4  # a head and three rows of seven columns
    assert json.loads(data)["training"] == "runs/compare"


def stored(path: Path, task: Task, seconds: list[float | None], *, generator: str = "residual") -> Path:
    """Write an evaluation with an attempt for each time, of which the first succeeded."""
    conditions = islice(task.conditions.stream("val"), len(seconds))
    attempts = [
        Attempt(
            condition=condition,
            generator=generator,
            outcome=Outcome(success=k == 0, checkpoint=5 if k == 0 else 0, failure="" if k == 0 else "slipped"),
            duration=1.0,
            cpu_seconds=each,
        )
        for k, (condition, each) in enumerate(zip(conditions, seconds, strict=True))
    ]
    measured = {generator: attempts}
    reports = reports_of(task, measured)
    write_evaluation(
        path, task, measured, reports=reports, gains=[], policies={generator: {"policy": "ab"}}, command=""
    )
    return path


def test_an_evaluation_is_read_back_with_what_an_attempt_costs(tmp_path: Path) -> None:
    (found,) = read_evaluations([stored(tmp_path / "a.json", CAN, [1.0, 2.0, None, 6.0])])
    assert (found.task, found.generator, found.count, found.seconds) == ("can", "residual", Count(1, 4), 3.0)
    found.check(CAN)


def test_an_evaluation_that_does_not_fit_is_refused_in_words(tmp_path: Path) -> None:
    (unknown,) = read_evaluations([stored(tmp_path / "old.json", CAN, [None, None])])
    assert math.isnan(unknown.seconds)
    with pytest.raises(ValueError, match=r"old\.json does not tell the processor time"):
        unknown.check(CAN)
    with pytest.raises(ValueError, match=r"old\.json was measured with another definition of 'can', or under another"):
        unknown.check(CAN.under(reflex="strict"))


def test_two_files_must_not_tell_of_the_same_pair(tmp_path: Path) -> None:
    paths = [stored(tmp_path / f"{name}.json", CAN, [1.0]) for name in "ab"]
    with pytest.raises(ValueError, match=r"a\.json and .*b\.json both tell of 'residual' on 'can'"):
        read_evaluations(paths)


@pytest.mark.parametrize("change", [{"reports": 5}, {"task_definition": None, "conditions": []}, {"cpu_seconds": [1]}])
def test_a_malformed_evaluation_is_named(change: dict[str, Any], tmp_path: Path) -> None:
    path = stored(tmp_path / "a.json", CAN, [1.0])
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(DamagedFileError, match=r"a\.json is damaged: it is no evaluation of one task"):
        read_evaluations([path])


def pair(path: Path, *, n: int, asked: int) -> Path:
    """Write what `table1` stores of a pair: attempts of 2 CPU-seconds, of which the first succeeded."""
    rows = [{"id": f"c{k}", "success": k == 0, "cpu_seconds": 2.0 if k else None} for k in range(n)]
    identity = {"generator": "residual", "policy": "ab", "blocks": 1, "attempts": asked}
    data = {"task": "can", "row": "grpo", "identity": identity, "definition": task_digest(CAN), "attempts": rows}
    path.write_text(json.dumps(data))
    return path


def test_a_pair_of_the_first_table_is_read_by_its_row_unless_it_ended_early(tmp_path: Path) -> None:
    (found,) = read_evaluations([pair(tmp_path / "grpo.json", n=3, asked=3)])
    assert (found.task, found.generator, found.count, found.seconds) == ("can", "grpo", Count(1, 3), 2.0)
    found.check(CAN)
    with pytest.raises(DamagedFileError, match="ended early"):
        read_evaluations([pair(tmp_path / "grpo.json", n=3, asked=4)])
