"""Every example runs, on short settings."""

from __future__ import annotations

import runpy
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dynaforge import MlpPolicyFile
from dynaforge.cli.main import main

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
FIRST_STEPS = {
    "watch_the_planner",
    "train",
    "compare_with_ppo",
    "collect_and_look",
    "train_an_imitator",
    "task_of_your_own",
}
Run = Callable[[str], str]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run an example in an empty folder as a command line would, and return what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(command: str) -> str:
        name, *arguments = shlex.split(command)
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        try:
            runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        except SystemExit as end:
            if end.code:
                pytest.fail(f"{command} ended with {end.code}")
        return capsys.readouterr().out

    return run


def test_the_first_steps_are_short_and_this_file_runs_each_of_them() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == FIRST_STEPS
    for name in FIRST_STEPS:
        assert f'run("{name}' in Path(__file__).read_text()
        lines = (EXAMPLES / f"{name}.py").read_text().splitlines()
        assert 30 <= sum(bool(line.strip()) for line in lines) <= 60


def test_watching_the_planner_says_how_each_condition_ends(run: Run) -> None:
    said = run("watch_the_planner --conditions 1")
    assert said.startswith("speed ")
    assert said.count("planner_only: ") == 1


def test_the_task_of_your_own_is_one_that_the_planner_solves_when_it_is_slow(run: Run) -> None:
    said = run("task_of_your_own").splitlines()
    assert len(said) == 8
    assert said[0].endswith("success")
    assert not said[-1].endswith("success")


def test_the_task_of_your_own_is_taken_by_the_commands(
    capsys: pytest.CaptureFixture[str], forget_tasks: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DYNAFORGE_TASKS", "")
    monkeypatch.setattr(sys, "path", list(sys.path))
    assert main(["describe", str(EXAMPLES / "task_of_your_own.py")]) == 0
    assert "# Tap" in capsys.readouterr().out
    forget_tasks()


def test_collected_demonstrations_are_looked_at(run: Run) -> None:
    said = run("collect_and_look --demos 1 --workers 1 --out data/can")
    assert "of all attempts: {" in said
    assert "'success': 1" in said
    assert "pregrasp > track" in said


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_film_shows_planner_and_policy_side_by_side(run: Run, tmp_path: Path) -> None:
    run("train --steps 50 --groups 2 --envs 2 --attempts 1 --out runs/policy.safetensors")
    said = run("watch_the_planner --conditions 1 --policy runs/policy.safetensors --film runs/can.gif")
    assert "residual: " in said
    assert (tmp_path / "runs" / "can.gif").read_bytes().startswith(b"GIF8")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_training_leaves_a_policy_and_measures_it(run: Run, tmp_path: Path) -> None:
    said = run("train --steps 50 --groups 2 --envs 2 --attempts 1 --out runs/policy.safetensors")
    assert "residual: " in said.splitlines()[-1]
    assert MlpPolicyFile.load(tmp_path / "runs" / "policy.safetensors").task == "can"


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.skipif(not (ROOT / "results").exists(), reason="results are not part of a source distribution")
def test_a_comparison_draws_its_figures(run: Run, tmp_path: Path) -> None:
    (tmp_path / "compare" / "toycar").mkdir(parents=True)
    shutil.copy(ROOT / "results" / "compare" / "toycar" / "runs.json", tmp_path / "compare" / "toycar")
    said = run("compare_with_ppo --task toycar --runs compare --report-only")
    assert "frontier_grpo: 84.7%, 86.0%, 85.7% of the test conditions" in said
    assert len(list((tmp_path / "runs" / "figures").glob("toycar-*.png"))) == 4


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
def test_an_imitator_is_trained_from_the_pack_and_acts(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    planner = ["--generator", "planner_only"]
    assert main(["collect", "--task", "can", *planner, "--demos", "1", "--out", "data/can", "--workers", "1"]) == 0
    small = ["--cameras", "front", "--size", "32", "32", "--points", "32", "--no-images", "--workers", "1"]
    assert main(["render", "data/can", *small]) == 0
    assert "update 0: mean error" in run("train_an_imitator data/can --updates 2")
    learner = ["--learner", f"{EXAMPLES}/train_an_imitator.py:load", "--observations", "data/can/observations"]
    few = ["--seeds", "1", "--attempts", "1", "--workers", "1", "--out", "learner.json"]
    assert main(["evaluate", "--task", "can", *learner, *few]) == 0
    assert "exception" not in Path("learner.json").read_text()
