"""The first table, from hand-made attempts whose numbers are worked by hand."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from dynaforge.generators.measurements import MeasuredAttempt, Measurement
from dynaforge.reports import table1_sections as sections
from dynaforge.reports.rate_grid import Cell
from dynaforge.reports.table1 import Table1
from dynaforge.reports.table1_files import CURVES, terminal_text, write_table1
from dynaforge.reports.table1_folder import note_refused, pair_path, read_table
from dynaforge.sim.loads import Loads
from dynaforge.sim.setting import Setting

SPEEDS = [0.1 * k for k in range(1, 11)]  # of the ten conditions of a block


def measurement(row: str, task: str, blocks: Sequence[str], *, lead: float = 0.0, **header: Any) -> Measurement:
    """A measurement, each block a text of ten letters: S succeeds gently, s with 50 N, d is dropped, m missed."""
    reasons = {"d": "dropped", "m": "missed close"}
    attempts = [
        MeasuredAttempt(
            id=f"{task}-{block}-{k}",
            block=block,
            difficulty=SPEEDS[k],
            speed=SPEEDS[k],
            success=letter in "sS",
            failure=reasons.get(letter, ""),
            loads=Loads(contact=0.5, standard=0.1 if letter == "S" else 1.3, strict=0.2 if letter == "S" else 2.5),
            wall_seconds=0.5,
            cpu_seconds=0.25,
        )
        for block, letters in enumerate(blocks)
        for k, letter in enumerate(letters)
    ]
    identity = {"stream": "test", "blocks": 2, "attempts": 10, "setting": Setting().to_dict()}
    entries = {
        "task": task,
        "row": row,
        "identity": identity,
        "definition": "f" * 16,
        "skill": "grasp",
        "unit": "m/s",
        "difficulty_range": (0.0, 1.0),
        "speed_range": (0.0, 1.0),
        "lead_time": lead,
    }
    return Measurement(header=entries | header, attempts=attempts)


ROWS = ("state_machine", "planner_only", "prediction", "residual", "replay")
MADE = {
    ("planner_only", "can"): measurement("planner_only", "can", ["SSSSdddddd", "SSdddddddm"]),  # 40 %, 20 %
    ("planner_only", "pen"): measurement("planner_only", "pen", ["SSSSSddddd", "SSSSSddddd"]),  # 50 %, 50 %
    ("prediction", "can"): measurement("prediction", "can", ["SSSSSdddmd", "SSSSdddddd"], lead=0.2),
    ("prediction", "pen"): measurement("prediction", "pen", ["SSSSSddddd", "SSSSSddddd"], lead=0.1),
    ("residual", "can"): measurement("residual", "can", ["SSSSSSSSsd", "SSSSSSSSSs"]),  # 90 %, 100 %
    ("residual", "pen"): measurement("residual", "pen", ["SSSSSSSddd", "dSSSSSSSSS"]),  # 70 %, 90 %
    ("state_machine", "can"): measurement("state_machine", "can", ["Smmmmmmmmm", "Smmmmmmmmm"]),  # 10 %
    ("replay", "can"): measurement("replay", "can", ["SSSSSSSSSS", "SSSSSSSSSS"]),
}
REFUSED = {("state_machine", "pen"): "state_machine cannot do task 'pen'; its supported tasks are can."}


@pytest.fixture(scope="module")
def table() -> Table1:
    return Table1(tasks=("can", "pen"), rows=ROWS, measured=MADE, refused=REFUSED)


def test_the_table_shows_rates_spreads_places_gains_and_what_is_missing(table: Table1) -> None:
    assert sections.headings(table) == ["generator", "can", "pen", "mean"]
    lines = {line.label: line for line in sections.rate_section(table)}
    assert list(lines) == [
        "State machine (DynamicVLA)",
        "Planner only",
        "Planner that predicts",
        "Residual",
        "Δ (pp)",
        "Replay (DOMINO)",
    ]
    assert lines["State machine (DynamicVLA)"].cells == (Cell("10.00", "0.00"), Cell("N/A"), Cell("10.00", "0.00"))
    assert lines["Planner only"].cells == (
        Cell("30.00", "10.00"),
        Cell("50.00", "0.00", 1),  # second best on the pen, as the one that predicts
        Cell("40.00", "5.00"),  # of the blocks (40 + 50) / 2 and (20 + 50) / 2
    )
    assert lines["Planner that predicts"].cells == (
        Cell("45.00", "5.00", 1),
        Cell("50.00", "0.00", 1),
        Cell("47.50", "2.50", 1),
    )
    assert lines["Residual"].cells == (Cell("95.00", "5.00", 0), Cell("80.00", "10.00", 0), Cell("87.50", "7.50", 0))
    assert lines["Δ (pp)"].cells == (Cell("+65.00"), Cell("+30.00"), Cell("+47.50"))
    assert lines["Replay (DOMINO)"].cells == (Cell("100.00", "0.00"), Cell("-"), Cell("100.00", "0.00"))
    assert [line.opens for line in lines.values()] == [False, False, False, False, True, True]


def test_the_differences_are_paired_with_the_residual(table: Table1) -> None:
    rows = {row[0]: row[1:] for row in sections.difference_rows(table)}
    assert list(rows) == ["State machine (DynamicVLA)", "Planner only", "Planner that predicts"]
    # Of 20 cans the residual alone gets 13, the planner alone none: p = 2 / 2^13
    can, pen, mean = rows["Planner only"]
    assert can.startswith("+65.0 [")
    assert can.endswith("], 13 : 0, p = 0.00024")
    assert pen.endswith("], 7 : 1, p = 0.07")  # 2 (1 + 8) / 2^8
    assert mean == "+47.5"
    assert rows["State machine (DynamicVLA)"][1:] == ["N/A", "+85.0"]


def test_thresholds_take_the_successes_whose_loads_they_bear(table: Table1) -> None:
    names, rows = sections.threshold_rows(table)
    assert names == "contact / standard / strict"
    cells = {row[0]: row[1:] for row in rows}
    assert cells["Residual"] == ["95.0 / 85.0 / 85.0", "80.0 / 80.0 / 80.0", "87.5 / 82.5 / 82.5"]
    assert cells["State machine (DynamicVLA)"][1] == "N/A"


def test_failures_stand_side_by_side_and_every_attempt_is_counted(table: Table1) -> None:
    (task, columns, rows), _ = sections.failure_tables(table)
    assert task == "can"
    assert columns[1:3] == ["State machine (DynamicVLA)", "Planner only"]
    assert rows == [
        ["dropped", "0", "13", "10", "1", "0"],
        ["missed close", "18", "1", "1", "0", "0"],
        ["success", "2", "6", "9", "19", "20"],
        ["attempts", "20", "20", "20", "20", "20"],
    ]


def test_critical_speeds_are_those_of_paired_rows_and_may_have_a_name(table: Table1) -> None:
    rows = {row[0]: row[1:] for row in sections.critical_rows(table)}
    assert "Replay (DOMINO)" not in rows
    assert table.curves["planner_only", "pen"].crossing == pytest.approx(0.55, abs=0.05)
    assert rows["Residual"][0].startswith("never falls")
    assert table.curves["state_machine", "can"].crossing == pytest.approx(0.15, abs=0.05)
    assert "[never reaches, " in rows["State machine (DynamicVLA)"][0]
    assert rows["State machine (DynamicVLA)"][1] == "N/A"


def test_the_files_say_the_same_as_the_table(table: Table1, tmp_path: Path, capsys: object) -> None:
    files = write_table1(tmp_path, table, command="dynaforge table1", minutes=2.5)
    assert [path.name for path in files] == ["table1.md", "table1.tex", "table1.json", CURVES]
    markdown = (tmp_path / "table1.md").read_text()
    for text in (
        "| generator | can | pen | mean |",
        "| *skill* | grasp | grasp |  |",
        "| Residual | **95.00** ±5.00 | **80.00** ±10.00 | **87.50** ±7.50 |",
        "| Planner that predicts | <u>45.00</u> ±5.00 | <u>50.00</u> ±0.00 |",
        "| Δ (pp) | +65.00 | +30.00 | +47.50 |",
        "- State machine (DynamicVLA), pen: state_machine cannot do task 'pen'",
        "stream test, 2 x 10 conditions",
        f"Setting of can, pen: {Setting()}.",
        "The prediction is by 0.1 s (pen), 0.2 s (can).",
        "attempts took 2.5 minutes of one core",
        "| paper: DynamicVLA | 42.67 ±5.44 | N/A | 42.67 |",
        f"]({CURVES})",
    ):
        assert text in markdown
    assert "ended early" not in markdown
    tex = (tmp_path / "table1.tex").read_text()
    assert r"Residual & \textbf{95.00}\DGRstd{5.00} & \textbf{80.00}\DGRstd{10.00}" in tex
    assert r"$\Delta$ (pp) & +65.00 & +30.00 & +47.50 \\" in tex
    assert tex.count("{") == tex.count("}")
    assert r"state\_machine" not in tex
    data = json.loads((tmp_path / "table1.json").read_text())
    assert data["cells"]["residual"]["can"]["mean"] == 0.95
    assert data["cells"]["state_machine"]["pen"] == {"not_available": REFUSED["state_machine", "pen"]}
    assert data["cells"]["planner_only"]["can"]["reference_less_this"]["only_b"] == 13
    assert data["cells"]["residual"]["can"]["critical_speed"]["critical"] == "never falls"
    assert data["gains"] == {"can": 65.0, "pen": 30.0, "mean": 47.5}
    assert data["unpaired"] == ["replay"]
    assert (tmp_path / CURVES).read_bytes().startswith(b"<?xml")
    printed = terminal_text(table)
    assert "95.00 ±5.00*" in printed
    assert "45.00 ±5.00+" in printed
    assert "N/A" in printed
    assert "Residual less Planner only: mean over the tasks +47.5 points" in printed


def test_comparisons_that_ended_early_report_the_saving() -> None:
    early = measurement("planner_only", "can", ["SSSSdddddd", "SSddd"])
    table = Table1(
        tasks=("can",),
        rows=("planner_only", "residual"),
        measured={("planner_only", "can"): early, ("residual", "can"): MADE["residual", "can"]},
        refused={},
        sequential=True,
    )
    ended = table.ended("planner_only", "can")
    assert ended is not None
    # The eighth pair that differs decides, as all of them are for the residual; it is the fifteenth of all.
    assert (ended.n, ended.available, ended.decided) == (15, 20, True)
    assert sections.saving_rows(table)[0][-1] == "25 % saved"
    assert table.difference("planner_only", "can").n == 15  # type: ignore[union-attr]
    assert "Planner only, compared until decided: 25 % saved" in terminal_text(table)


def test_what_was_measured_on_other_conditions_is_not_compared() -> None:
    other = measurement("residual", "can", ["SSSSSSSSSS"], definition="0" * 16)
    with pytest.raises(ValueError, match="residual and planner_only were not measured on the same conditions of the"):
        Table1(
            tasks=("can",),
            rows=("planner_only", "residual"),
            measured={("planner_only", "can"): MADE["planner_only", "can"], ("residual", "can"): other},
            refused={},
        )


def test_a_folder_gives_back_the_table_and_what_is_refused_now_is_not_shown(tmp_path: Path, table: Table1) -> None:
    for (row, task), found in MADE.items():
        found.save(pair_path(tmp_path, row, task))
    note_refused(tmp_path, REFUSED, ["can", "pen"], ROWS)
    again = read_table(tmp_path, ["can", "pen", "peg"], ROWS)
    assert again.tasks == ("can", "pen")
    assert again.refused == REFUSED
    assert terminal_text(again) == terminal_text(table)
    note_refused(tmp_path, {("residual", "can"): "another definition"}, ["can"], ["residual"])
    later = read_table(tmp_path, ["can", "pen"], ROWS)
    assert later.refused == {**REFUSED, ("residual", "can"): "another definition"}
    assert ("residual", "can") not in later.measured
    note_refused(tmp_path, {}, ["can"], ["residual"])
    assert read_table(tmp_path, ["can", "pen"], ROWS).refused == REFUSED
    with pytest.raises(ValueError, match="holds nothing of these"):
        read_table(tmp_path, ["peg"], ROWS)
    (tmp_path / "refused.json").write_text("[1]")
    with pytest.raises(ValueError, match=r"refused\.json is damaged"):
        read_table(tmp_path, ["can"], ROWS)
