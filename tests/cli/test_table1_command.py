"""`dynaforge table1`: pair by pair, going on after a kill, refusing before any work; mostly with hand-made attempts."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli.main import main
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import PlannerOnly, Result
from dynaforge.generators import measure as measuring
from dynaforge.generators.attempts import failed_attempt
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome, get_task
from dynaforge.tasks.digest import definition_of

FASTEST = {"planner_only": 0.1, "prediction": 0.15, "residual": 9.0}
"""Speed, m/s, up to which each generator succeeds here."""


class Engine:
    """Makes attempts without simulation; it counts them, and is interrupted at the one of a number."""

    def __init__(self) -> None:
        self.made: list[tuple[str, str]] = []
        self.interrupted_at: int | None = None

    def __call__(
        self, task: Any, generator: Any, conditions: Iterable[Condition], *, workers: int | None
    ) -> Iterator[Result]:
        for condition in conditions:
            if len(self.made) == self.interrupted_at:
                raise KeyboardInterrupt
            self.made.append((task.name, generator.name))
            attempt = failed_attempt(condition, generator.name, "dropped").attempt
            if condition.difficulty < FASTEST[generator.name]:
                attempt = replace(attempt, outcome=Outcome(success=True, checkpoint=len(task.phases)))
            yield Result(replace(attempt, cpu_seconds=3.0), PlannerOnly())  # type: ignore[arg-type]


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> Engine:
    made = Engine()
    monkeypatch.setattr(measuring, "run_attempts", made)
    return made


def policy_of_can(path: Path) -> None:
    """Make the file of a policy for Can."""
    inputs, outputs = ResidualEnv.sizes("can")
    layer = (np.zeros((outputs, inputs), np.float32), np.zeros(outputs, np.float32))
    path.parent.mkdir(parents=True, exist_ok=True)
    MlpPolicyFile([layer], "Tanh", task="can", meta=definition_of(get_task("can"))).save(path)


def run(out: Path, *more: str, generators: str = "planner_only prediction residual", task: str = "can pen") -> int:
    """Run the command; its only residual policy, if the residual is asked for, is one for Can."""
    asked = ["table1", "--generators", *generators.split(), "--task", *task.split(), "--out", str(out)]
    if "residual" in generators:
        policy_of_can(out.parent / "policies" / "can" / "policy.safetensors")
        asked += ["--policies", str(out.parent / "policies")]
    return main([*asked, *(more or ("--seeds", "2", "--attempts", "10"))])


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_pair_is_measured_once_and_what_is_not_done_is_said(
    engine: Engine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path / "out") == 0
    counts = {pair: engine.made.count(pair) for pair in set(engine.made)}
    pairs = [(task, row) for task in ("can", "pen") for row in FASTEST if (task, row) != ("pen", "residual")]
    assert counts == dict.fromkeys(pairs, 20)
    printed = capsys.readouterr().out
    assert "5 pairs of generator and task" in printed
    assert f"Residual, pen: {tmp_path / 'policies'} has no policy for pen" in printed
    assert "can, residual: 20 of 20 attempts succeed" in printed
    assert "| Residual" in printed.replace("│", "|")
    assert "N/A" in printed
    assert re.search(r"took \d+\.\d minutes", printed)
    names = {"table1.md", "table1.tex", "table1.json", "table1-curves.svg", "refused.json"}
    assert names | {f"{task}/{row}.json" for task, row in pairs} == set(contents(tmp_path / "out"))
    data = json.loads((tmp_path / "out" / "table1.json").read_text())
    assert data["core_minutes"] == 5.0
    assert data["cells"]["residual"]["can"]["mean"] == 1.0
    assert data["cells"]["residual"]["pen"]["not_available"].endswith("no policy for pen")
    assert data["command"].startswith("dynaforge table1 --generators planner_only")

    engine.made.clear()
    before = contents(tmp_path / "out")
    assert run(tmp_path / "out") == 0
    assert engine.made == []
    assert run(tmp_path / "out", "--report-only") == 0
    after = contents(tmp_path / "out")
    assert {name for name in before if before[name] != after[name]} == {"table1.md", "table1.tex", "table1.json"}
    assert "**100.00** ±0.00" in after["table1.md"].decode()


def test_after_a_kill_it_goes_on_with_the_pair_under_way(engine: Engine, tmp_path: Path) -> None:
    engine.interrupted_at = 33  # in the second of five pairs
    assert run(tmp_path / "out") == 130
    assert [path.name for path in (tmp_path / "out" / "can").iterdir()] == ["planner_only.json"]
    engine.made.clear()
    engine.interrupted_at = None
    assert run(tmp_path / "out") == 0
    assert len(engine.made) == 80
    assert ("can", "planner_only") not in engine.made


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--seeds", "2", "--attempts", "5"], "was measured with attempts 10, now attempts 5 is asked for"),
        (["--seeds", "2", "--attempts", "10", "--stream", "val"], "stream 'test', now stream 'val'"),
        (["--seeds", "2", "--attempts", "10", "--reflex", "strict"], "with setting (reflex contact"),
    ],
)
def test_a_folder_of_other_conditions_is_refused_before_any_work(
    engine: Engine, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], words: str
) -> None:
    assert run(tmp_path / "out", generators="planner_only", task="can") == 0
    before = contents(tmp_path / "out")
    engine.made.clear()
    capsys.readouterr()
    assert run(tmp_path / "out", *more) == 2
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1
    assert not engine.made
    assert contents(tmp_path / "out") == before


def test_comparisons_end_early_only_where_asked_to_and_the_rest_can_be_made_up(
    engine: Engine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["--seeds", "3", "--attempts", "20"]
    assert run(tmp_path / "out", *asked, "--sequential", task="can", generators="planner_only residual") == 0
    assert engine.made[:60] == [("can", "residual")] * 60  # what the others are compared with, in full
    n = len(engine.made) - 60
    assert 8 <= n < 20
    printed = capsys.readouterr().out
    assert f"Planner only, compared until decided: {100 * (1 - n / 60):.0f} % saved" in printed
    assert "ended early" in (tmp_path / "out" / "table1.md").read_text()
    engine.made.clear()
    assert run(tmp_path / "out", *asked, task="can", generators="planner_only residual") == 0
    assert engine.made == [("can", "planner_only")] * (60 - n)
    assert "ended early" not in (tmp_path / "out" / "table1.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--generators oracle oracle", "--generators names 'oracle' twice"),
        ("--generators magic", "No generator 'magic'"),
        ("--generators grpo", "--generators grpo needs --grpo-policies DIR"),
        ("--generators planner_only --policies {empty}", "--policies is for the row residual"),
        ("--generators residual --grpo-policies {empty}", "--grpo-policies is for the row grpo"),
        ("--report-only --out {empty}", "--report-only finds nothing measured in"),
        ("--out {full}", "holds other data (can)"),
        ("--task can --generators residual --policies {full}", "--policies: "),
        ("--task can --generators grpo --grpo-policies {full}", "--grpo-policies: "),
        ("--task can --generators residual --policies {empty}", "None of the generators does any of the tasks"),
    ],
)
def test_what_makes_no_table_is_refused_before_any_work(
    engine: Engine, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: str, words: str
) -> None:
    full = tmp_path / "full"
    (tmp_path / "empty").mkdir()
    (full / "can").mkdir(parents=True)
    (full / "thesis.txt").write_text("years of work")
    (full / "can" / "policy.safetensors").write_text("none")
    line = arguments.format(empty=tmp_path / "empty", full=full).split()
    out = [] if "--out" in line else ["--out", str(tmp_path / "out")]
    before = contents(tmp_path)
    assert main(["table1", *line, *out]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not engine.made
    assert contents(tmp_path) == before


def test_policies_of_vanilla_grpo_make_a_row_from_a_folder_of_compare(engine: Engine, tmp_path: Path) -> None:
    policy_of_can(tmp_path / "runs" / "can" / "grpo" / "seed-0" / "policy.safetensors")
    given = ["--grpo-policies", str(tmp_path / "runs"), "--seeds", "1", "--attempts", "3"]
    assert run(tmp_path / "out", *given, generators="grpo planner_only") == 0
    assert (tmp_path / "out" / "can" / "grpo.json").is_file()
    noted = json.loads((tmp_path / "out" / "refused.json").read_text())
    assert noted == {"can": {}, "pen": {"grpo": f"{tmp_path / 'runs'} has no policy for pen"}}


def test_evaluate_ends_comparisons_early_too(
    engine: Engine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy_of_can(tmp_path / "p")
    asked = ["evaluate", "--generator", "residual", "planner_only", "--policy", str(tmp_path / "p")]
    assert main([*asked, "--out", str(tmp_path / "e.json"), "--seeds", "2", "--attempts", "20", "--sequential"]) == 0
    n = engine.made.count(("can", "planner_only"))
    assert engine.made == [("can", "residual")] * 40 + [("can", "planner_only")] * n
    assert f"decided after {n} of 40 conditions" in capsys.readouterr().out
    stored = json.loads((tmp_path / "e.json").read_text())
    assert [len(outcomes) for outcomes in stored["outcomes"].values()] == [40, n]
    assert stored["gains"]["planner_only"]["sequential"]["n"] == n < 20


def test_it_measures_what_evaluate_measures(tmp_path: Path) -> None:
    asked = ["--task", "can", "--seeds", "1", "--attempts", "2", "--stream", "test", "--workers", "1"]
    assert main(["table1", *asked, "--generators", "planner_only", "--out", str(tmp_path / "out")]) == 0
    assert main(["evaluate", *asked, "--generator", "planner_only", "--out", str(tmp_path / "e.json")]) == 0
    table = json.loads((tmp_path / "out" / "can" / "planner_only.json").read_text())
    evaluated = json.loads((tmp_path / "e.json").read_text())
    assert [attempt["id"] for attempt in table["attempts"]] == [c["id"] for c in evaluated["conditions"]]
    outcomes = ["success" if a["success"] else a["failure"] for a in table["attempts"]]
    assert outcomes == evaluated["outcomes"]["planner_only"]
