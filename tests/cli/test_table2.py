"""`dynaforge table2`: what is missing is measured once, and what does not fit is refused before any attempt."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from dynaforge.cli.arguments.table2 import TASKS
from dynaforge.cli.main import main
from dynaforge.demos import Attempt
from dynaforge.evaluation.costs import PAPER_TASKS
from dynaforge.generators import pairs
from dynaforge.reports.evaluation import reports_of, write_evaluation
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome, Task, get_task
from dynaforge.tasks.digest import definition_of

CAN = get_task("can")
LINE = ["table2", "--task", "can", "--seeds", "1", "--attempts", "4", "--generator"]


def attempts(generator: str, conditions: list[Condition]) -> list[Attempt]:
    """Attempts of one CPU-second, of which every second one succeeds."""
    return [
        Attempt(
            condition=condition,
            generator=generator,
            outcome=Outcome(success=k % 2 == 0, checkpoint=5 if k % 2 == 0 else 0, failure="slipped" if k % 2 else ""),
            duration=1.0,
            cpu_seconds=1.0,
        )
        for k, condition in enumerate(conditions)
    ]


def evaluation(path: Path, generator: str, task: Task = CAN) -> Path:
    measured = {generator: attempts(generator, list(islice(task.conditions.stream("test"), 4)))}
    write_evaluation(
        path, task, measured, reports=reports_of(task, measured), gains=[], policies={}, command="dynaforge evaluate"
    )
    return path


def training(folder: Path, *hours: float, variant: str = "failures") -> Path:
    for seed, each in enumerate(hours):
        run = folder / "can" / variant / f"seed-{seed}"
        run.mkdir(parents=True)
        history = {"timesteps": [9], "probes": [], "collect_cpu": [3600.0 * each], "optimize_cpu": [0.0]}
        files = {
            "run.json": {"run": {"arm": variant, "seed": seed, **definition_of(CAN)}, "settings": {}},
            "history.json": history,
            "exam.json": {"task": "can", "attempts": []},
        }
        for name, content in files.items():
            (run / name).write_text(json.dumps(content))
    return folder


@dataclass
class Counted:
    """A stand-in for measuring, which counts its calls."""

    calls: int = 0

    def __call__(self, task: Task, generator: Any, blocks: Any, **_: Any) -> list[Attempt]:
        self.calls += 1
        return attempts(generator.name, [condition for block in blocks for condition in block])


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Counted:
    monkeypatch.chdir(tmp_path)
    measure = Counted()
    monkeypatch.setattr(pairs, "measure", measure)
    return measure


def test_the_tasks_are_those_of_the_paper_unless_others_are_named() -> None:
    assert TASKS == PAPER_TASKS


def test_what_is_missing_is_measured_once(counted: Counted, capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        assert main([*LINE, "planner_only", "prediction"]) == 0
    assert counted.calls == 2
    out = Path("runs/table2")
    (planner, _) = json.loads((out / "table2.json").read_text())["pairs"]
    assert (planner["rate"], planner["attempts"], planner["cpu_seconds"]) == (0.5, 1600.0, 1.0)
    assert planner["collection_hours"] == pytest.approx(1600 / 3600)
    assert "1,600" in capsys.readouterr().out
    assert main([*LINE, "prediction", "--lead-time", "1.5"]) == 2  # another prediction is another generator
    assert "prediction.json was measured with another definition of task 'can'" in capsys.readouterr().err
    assert main([*LINE, "planner_only", "--attempts", "5"]) == 2
    assert "was measured with attempts 4, now attempts 5" in capsys.readouterr().err


def test_training_counts_for_the_residual_and_nothing_is_measured_twice(counted: Counted, tmp_path: Path) -> None:
    files = [evaluation(tmp_path / f"{name}.json", name) for name in ("planner_only", "residual")]
    folder = training(tmp_path / "compare", 0.5, 1.5)
    line = [*LINE, "planner_only", "residual", "--training", str(folder), "--measured", *map(str, files)]
    assert main([*line, "--out", "costs", "--demos", "3600"]) == 0
    assert counted.calls == 0
    totals = json.loads(Path("costs/table2.json").read_text())["totals"]
    assert totals["residual"]["preparation_hours"] == pytest.approx(1.0)
    assert totals["residual"]["hours"] == pytest.approx(1.0 + 2.0)
    assert totals["planner_only"]["hours"] == pytest.approx(2.0, abs=0.01)  # making it takes a moment
    assert totals["planner_only"]["model_hours"] == pytest.approx(4.0)


def test_what_a_generator_cannot_do_is_told_and_the_others_are_measured(
    counted: Counted, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(training(tmp_path / "compare", 0.5))
    assert main([*LINE, "planner_only", "grpo", "--training", folder]) == 0
    assert counted.calls == 1
    assert "grpo on can: the attempts of grpo are those of `dynaforge table1`" in capsys.readouterr().out
    stored = json.loads(Path("runs/table2/table2.json").read_text())
    assert stored["totals"]["grpo"]["hours"] is None
    assert main([*LINE, "grpo", "--training", folder, "--out", "other"]) == 2
    assert "None of the generators does any of the tasks: the attempts of grpo" in capsys.readouterr().err
    assert not Path("other").exists()


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        (lambda t: ["residual"], "--training is missing"),
        (lambda t: ["planner_only", "--variant", "failures"], "--variant failures is one of --training"),
        (lambda t: ["planner_only", "--lead-time", "0.1"], "is for the generator prediction"),
        (
            lambda t: ["residual", "--training", str(training(t / "c", 1.0)), "--variant", "grpo"],
            "no finished training of 'can' by 'grpo', but by failures",
        ),
        (
            lambda t: ["residual", "--training", str(training(training(t / "c", 1.0), 1.0, variant="grpo"))],
            "choose one of these variants",
        ),
        (
            lambda t: ["planner_only", "--reflex", "strict", "--measured", str(evaluation(t / "a", "planner_only"))],
            "under another setting than",
        ),
        (
            lambda t: [
                *("residual", "--training", str(t), "--policy", str(evaluation(t / "a", "a"))),
                *("--task", "can", "peach"),
            ],
            "is for one task",
        ),
    ],
)
def test_what_does_not_fit_is_refused_before_the_work(
    line: Callable[[Path], list[str]],
    complaint: str,
    counted: Counted,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([*LINE, *line(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
    assert counted.calls == 0
    assert not Path("runs").exists()


def test_attempts_of_the_planner_are_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "costs"
    assert main([*LINE, "planner_only", "--attempts", "2", "--workers", "1", "--out", str(out)]) == 0
    (pair,) = json.loads((out / "table2.json").read_text())["pairs"]
    assert pair["n"] == 2
    assert 0.0 < pair["cpu_seconds"] < 60.0
