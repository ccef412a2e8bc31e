"""A task's name, its file and the ids of its envs stand for each other in every command."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from dynaforge.cli import compare
from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.cli.arguments.tasks import chosen_task, chosen_tasks
from dynaforge.cli.commands import COMMANDS
from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.provenance import Provenance
from dynaforge.generators import Generator, Goal, PlannerOnly, collect
from dynaforge.generators.attempts import Result, failed_attempt
from dynaforge.sim import Condition
from dynaforge.tasks import Task, get_task
from dynaforge.tasks.digest import task_digest
from dynaforge.training.run_spec import RunSpec
from dynaforge.training.settings import variants

ONE = {"forge": ["--task"], "collect": ["--task"], "report": ["motivation", "--task"]}
SEVERAL = {"describe": [], "table2": ["--generator", "planner_only", "--task"]}
SEVERAL |= {name: ["--task"] for name in ("evaluate", "compare", "bench", "table1")}
ON_DATASETS = {"info": [], "verify": [], "render": [], "view": [], "export": ["--format", "minari"]}
WITHOUT = {"list"}
FORMS = ("ball.py", "ball", "BALL", "DynaForge/Ball-v0", "DynaForge/BallTask-v0", "dynaforge:DynaForge/Ball-v0")


def test_every_command_that_is_about_a_task_is_tested_here() -> None:
    assert set(COMMANDS) == {*ONE, *SEVERAL, *ON_DATASETS, *WITHOUT}, "and those of rl_zoo3 in test_zoo_env.py"


@pytest.fixture
def balls(ball: Path, forget_tasks: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Hold a dataset of the task, by a process that has ended."""
    monkeypatch.chdir(ball.parent)
    task = get_task("ball.py")
    dataset = DemonstrationDataset("balls", task=task.name)
    dataset.note_source("planner_only", Provenance("", task_digest(task), "ball.py"))
    forget_tasks()
    return ball.parent / "balls"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("command", [*ONE, *SEVERAL])
def test_a_task_of_ones_own_is_taken_by_name_file_and_id(balls: Path, command: str, form: str) -> None:
    get_task("ball.py")
    options = COMMANDS[command].read(command, [*(ONE | SEVERAL)[command], form])
    task = chosen_task(options) if command in ONE else chosen_tasks(options)[0]
    assert task is get_task("ball.py")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("option", ["--task", "--task-file"])
def test_a_dataset_takes_its_task_by_name_file_and_id(balls: Path, form: str, option: str) -> None:
    get_task("ball.py")
    for command, more in ON_DATASETS.items():
        options = COMMANDS[command].read(command, ["balls", *more, option, form])
        assert open_dataset(options)[1] is get_task("ball.py")


@pytest.mark.parametrize("command", ON_DATASETS)
def test_a_dataset_is_read_only_with_the_task_that_it_was_made_with(
    balls: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*more: str) -> str:
        assert main([command, "balls", *ON_DATASETS[command], *more]) == 2
        message = capsys.readouterr().err
        assert message.count("\n") == 1
        return message

    (source,) = DemonstrationDataset("balls").sources().values()
    remedy = f"was made with ball.py (task 'ball', digest {source.task_definition}); give it with --task-file ball.py."
    assert remedy in refused()
    assert "ball" not in sys.modules, "what a dataset names is not imported"
    assert "balls holds demonstrations of task 'ball'; bottle is task 'bottle'" in refused("--task-file", "bottle")
    Path("other.py").write_text(Path("ball.py").read_text().replace("timeout=3.0", "timeout=3.5"))
    message = refused("--task-file", "other.py")
    assert "phases or residual of other.py differ" in message
    assert remedy in message


def test_demonstrations_forged_with_another_frame_are_of_the_same_file(balls: Path) -> None:
    task = get_task("ball.py")
    other = replace(task, residual=replace(task.residual, frame="world"))
    dataset = DemonstrationDataset("more", task="ball")
    dataset.note_source("residual", Provenance("p", task_digest(other), "ball.py"))
    assert open_dataset(Namespace(folder=Path("more"), task_file="ball.py"))[1].residual.frame == "world"


def test_collecting_notes_the_file_and_no_folder_of_it(balls: Path) -> None:
    dataset = DemonstrationDataset("again", task="ball")

    def engine(task: Task, generator: Generator, conditions: Iterable[Condition], **_: object) -> Iterator[Result]:
        return (failed_attempt(condition, generator.name, "no wind") for condition in conditions)

    collect(dataset, get_task("ball.py"), PlannerOnly(), Goal(None, 1), engine=engine)
    assert json.loads(Path("again/generators.json").read_text())["planner_only"]["task_file"] == "ball.py"


@pytest.mark.parametrize("named", [("white_noise",), pytest.param(tuple(variants()), marks=pytest.mark.slow)])
def test_compare_takes_a_task_of_ones_own_in_every_arm(balls: Path, named: tuple[str, ...]) -> None:
    asked = ["--train-seeds", "1", "--out", "runs", "--algos", *named]
    by_file, by_id = (
        compare.matrix(COMMANDS["compare"].read("compare", ["--task", form, *asked]))
        for form in ("ball.py", "DynaForge/Ball-v0")
    )
    assert len(by_file) == 1 + len(named)
    assert by_file == by_id
    assert {RunSpec.from_json(spec.to_json()).identity()["task"] for spec in by_file} == {"ball"}


def test_the_list_of_tasks_holds_those_that_are_known(balls: Path, capsys: pytest.CaptureFixture[str]) -> None:
    get_task("ball.py")
    assert main(["list"]) == 0
    assert "DynaForge/Ball-v0" in capsys.readouterr().out
