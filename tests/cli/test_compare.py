from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli import compare
from dynaforge.cli.commands import COMMANDS
from dynaforge.cli.main import main
from dynaforge.demos import Episode
from dynaforge.sim import Condition
from dynaforge.sim.setting import Setting
from dynaforge.tasks import Outcome
from dynaforge.training import monitor
from dynaforge.training import run as runs
from dynaforge.training.history import TrainingHistory
from dynaforge.training.matrix import check_variants
from dynaforge.training.run_spec import Evaluation, RunSpec
from dynaforge.training.settings import variants
from dynaforge.training.stored_training import CHECKPOINT

TINY = {"n_groups": 4, "group_size": 2, "n_envs": 4}


class Failing:
    """A generator that makes an episode without a step."""

    name = "planner_only"

    def attempt(self, env: Any, condition: Condition) -> Episode:
        outcome = Outcome(success=False, checkpoint=0, n_checkpoints=1, failure="asleep", phase="wait")
        return Episode(condition=condition, generator=self.name, outcome=outcome, duration=0.0, steps={}, meta={})


def options(*arguments: str) -> argparse.Namespace:
    return COMMANDS["compare"].read("compare", arguments)


def tiny(folder: Path, **changes: object) -> RunSpec:
    spec = RunSpec(
        task="can",
        setting=Setting(),
        variant="frontier_grpo",
        algo="frontier_grpo",
        changes=TINY,
        seed=0,
        steps=300,
        evaluation=Evaluation("val", 1, 2),
        folder=folder,
    )
    return replace(spec, **changes)  # type: ignore[arg-type]


def test_the_matrix_goes_seed_by_seed(tmp_path: Path) -> None:
    asked = options("--task", "can", "peach", "--algos", "ppo", "strata", "--train-seeds", "2", "--out", str(tmp_path))
    specs = compare.matrix(asked)
    assert [(s.task, s.variant, s.seed) for s in specs] == [
        ("can", "planner_only", 0),
        ("peach", "planner_only", 0),
        *((task, arm, seed) for seed in range(2) for task in ("can", "peach") for arm in ("ppo", "strata")),
    ]
    assert len({s.folder for s in specs}) == len(specs)
    assert specs[3].algo == "grpo"
    assert specs[3].changes == {"stratified": True}


def test_a_setting_may_be_varied(tmp_path: Path) -> None:
    asked = options("--algos", "grpo", "--train-seeds", "1", "--vary", "learning_rate", "1e-3", "2e-3")
    assert [spec.changes for spec in compare.matrix(asked)[1:]] == [{"learning_rate": 1e-3}, {"learning_rate": 2e-3}]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--algos", "pp"], "No algorithm 'pp'. Did you mean 'ppo'? Known are ppo, grpo, frontier_grpo"),
        (["--task", "cann"], "Did you mean 'can'"),
        (["--train-seeds", "0"], "--train-seeds is 0; it must be at least 1"),
        (["--algos", "grpo", "--vary", "learning_rat", "1"], "unexpected keyword argument 'learning_rat'"),
        (["--algos", "grpo", "--vary", "group_size", "1"], "group_size is 1, but must be at least 2"),
        (["--algos", "ppo", "--vary", "learning_rate", "fast"], "--vary: learning_rate is 'fast', but must be"),
        (["--algos", "ppo", "--vary", "learning_rate", "NaN"], "--vary: 'NaN' is no finite number"),
        (["--algos", "ppo", "--report-only"], "--report-only finds nothing finished"),
        (["--vary", "group_size"], "--vary group_size names no values"),
        (["--algos", "grpo", "--vary", "n_envs", "0"], "n_envs is 0, but must be at least 1"),
        (["--algos", "ppo", "--vary", "batch_size", "1.5"], "--vary: batch_size is 1.5, but must be a whole number"),
        (["--algos", "ppo", "--vary", "gamma", "1", "2"], "--vary: gamma is 2, but must be at most 1"),
        (["--vary", "seed", "1", "2"], "--vary: seed is counted up by --train-seeds"),
        (["--algos", "grpo", "--vary", "n_timesteps", "10"], "n_timesteps is what --steps says"),
        (["--algos", "grpo", "--vary", "learning_rate", "fast"], "learning_rate is 'fast', but must be a number"),
    ],
)
def test_mistakes_are_said_before_any_run(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *arguments, "--out", str(tmp_path / "runs")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_only_a_folder_of_runs_is_written_to_and_no_link_in_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    assert main(["compare", "--out", str(tmp_path / "mine")]) == 2
    assert "holds other data (thesis.txt)" in capsys.readouterr().err
    for link in ("can", "can/planner_only", "can/ppo", "can/ppo/seed-0"):
        out = tmp_path / f"a stranger's {link.replace('/', '-')}"
        path = out / link
        path.parent.mkdir(parents=True)
        path.symlink_to(tmp_path / "mine")
        (out / "peach" / "planner_only").mkdir(parents=True)
        assert main(["compare", "--algos", "ppo", "--train-seeds", "1", "--out", str(out)]) == 2
        assert f"{path} is a link" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]


def test_a_run_survives_json(tmp_path: Path) -> None:
    spec = tiny(tmp_path)
    assert RunSpec.from_json(spec.to_json()) == spec
    assert RunSpec.from_json(spec.to_json()).folder == spec.folder


@pytest.mark.slow
@pytest.mark.timeout(170)
def test_a_run_that_was_cut_off_ends_as_if_it_had_not_been(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "SAVED_EVERY", 1)
    monkeypatch.setattr(runs, "PROBED_EVERY", 2)
    whole, cut = tiny(tmp_path / "whole"), tiny(tmp_path / "cut")
    runs.train(whole)
    calls = 0

    def cut_off(**what: object) -> None:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(runs, "report_progress", cut_off)
        with pytest.raises(KeyboardInterrupt):
            runs.train(cut)
    assert (cut.folder / CHECKPOINT).is_file()
    assert not cut.finished
    runs.train(cut)
    assert cut.finished
    assert not (cut.folder / CHECKPOINT).exists()
    assert (cut.folder / "policy.safetensors").read_bytes() == (whole.folder / "policy.safetensors").read_bytes()
    histories = [TrainingHistory.load(spec.folder / "history.json") for spec in (whole, cut)]
    for name in ("successes", "trials", "groups", "timesteps", "optimizer_steps", "transitions_used", "probes"):
        assert getattr(histories[0], name) == getattr(histories[1], name), name
    assert histories[0].timesteps[-1] >= 300
    assert [probe.update for probe in histories[0].probes][:2] == [0, 2]


@pytest.mark.slow
@pytest.mark.timeout(170)
def test_a_run_of_sac_has_updates_resumes_and_leaves_a_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "SAVED_EVERY", 1)
    monkeypatch.setattr(monitor, "UPDATE_OF_SAC", 40)
    changes = {"learning_starts": 60, "update_ratio": 1, "n_envs": 4, "batch_size": 8}
    spec = tiny(tmp_path, variant="sac", algo="residual_sac", changes=changes, steps=120)

    def cut_off(**what: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(runs, "report_progress", cut_off)
        with pytest.raises(KeyboardInterrupt):
            runs.train(spec)
    assert (spec.folder / CHECKPOINT).is_file()
    runs.train(spec)
    assert spec.finished
    history = TrainingHistory.load(spec.folder / "history.json")
    assert history.timesteps == [40, 80, 120]
    assert history.optimizer_steps[0] == 0, "the planner's steps"
    assert 0 < history.optimizer_steps[2] <= 60, "one for each step once an episode has ended"
    assert all(len(row) == 3 for row in (history.successes, history.collect_cpu, history.optimize_cpu))
    assert history.optimize_cpu[2] > history.optimize_cpu[0]
    assert history.probes[0].update == 0
    assert MlpPolicyFile.load(spec.folder / "policy.safetensors").squash_mean


def test_a_folder_of_another_run_is_refused(tmp_path: Path) -> None:
    spec = tiny(tmp_path)
    about = {"run": spec.identity(), "settings": spec.settings()}
    (tmp_path / "run.json").write_text(json.dumps(about))
    spec.check()
    with pytest.raises(ValueError, match=r"holds a run with \{'steps': 300\}, now \{'steps': 400\} is asked for"):
        replace(spec, steps=400).check()
    default = replace(spec, changes={**TINY, "learning_rate": None})  # FrontierGRPO's own, whatever zoo_configs says
    assert "learning_rate" not in default.settings()
    (tmp_path / "run.json").write_text(json.dumps(about | {"settings": default.settings()}))
    default.check()
    about["settings"]["learning_rate"] = 7.0  # zoo_configs was changed since
    (tmp_path / "run.json").write_text(json.dumps(about))
    with pytest.raises(ValueError, match=r"'learning_rate': 7\.0"):
        spec.check()


def test_a_run_of_another_definition_is_refused_and_nothing_is_touched(tmp_path: Path) -> None:
    spec = tiny(tmp_path)
    written = json.dumps({"run": spec.identity(), "settings": spec.settings()})
    (tmp_path / "run.json").write_text(written)
    strict = replace(spec, setting=Setting(reflex="strict"))
    with pytest.raises(ValueError) as refused:
        strict.check()
    asked = f"made under {spec.setting}, now {strict.setting} is asked for"
    remedy = "Choose another --out, or --report-only without a setting to report what is stored."
    assert str(refused.value) == f"{tmp_path} holds a run {asked}. {remedy}"
    strict.check(definition=False)
    other = json.loads(written)
    other["run"]["task_definition"] = "0" * 16
    (tmp_path / "run.json").write_text(json.dumps(other))
    with pytest.raises(ValueError, match="holds a run of another definition of task 'can' than the present one"):
        spec.check()
    for field in ("task_definition", "in_any_setting", "setting"):
        del other["run"][field]
    (tmp_path / "run.json").write_text(json.dumps(other))
    with pytest.raises(ValueError, match="holds a run made under older physics, now reflex contact, physics varied"):
        spec.check()
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_the_planner_of_another_setting_is_refused(tmp_path: Path) -> None:
    planner = tiny(tmp_path / "planner_only", variant="planner_only", algo="", changes={}, steps=0)
    planner.folder.mkdir()
    runs.evaluate(planner.make_task(), Failing(), replace(planner.evaluation, attempts=1), planner.folder / "exam.json")
    with pytest.raises(ValueError, match="'attempts': 1"):
        planner.check()
    replace(planner, evaluation=replace(planner.evaluation, attempts=1)).check()
    with pytest.raises(ValueError, match="now reflex contact, physics wide, sensing ideal is asked for"):
        replace(planner, setting=Setting(physics="wide")).check()


def test_the_setting_reaches_every_run() -> None:
    specs = compare.matrix(options("--algos", "grpo", "--reflex", "30", "--sensing", "real", "--train-seeds", "1"))
    for spec in specs:
        task = RunSpec.from_json(spec.to_json()).make_task()
        assert task.setting == Setting(reflex=30.0, sensing="real")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_compare_runs_reports_and_repeats_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = [
        "compare",
        "--algos",
        "ppo",
        "grpo",
        "frontier_grpo",
        "--train-seeds",
        "1",
        "--steps",
        "1",
        "--attempts",
        "2",
    ]
    asked += ["--seeds", "1", "--stream", "val", "--out", str(tmp_path)]
    assert main(asked) == 0
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("exam.json")}
    assert len(before) == 4
    assert main(asked) == 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("exam.json")} == before
    assert "4 runs, 4 finished" in capsys.readouterr().out
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/svg+xml") == 5
    assert "frontier_grpo" in (tmp_path / "table.txt").read_text()


@pytest.mark.parametrize("variant", variants())
def test_every_variant_builds_its_model(variant: str) -> None:
    settings = dict(variants()[variant])
    check_variants({variant: (settings.pop("config"), settings)}, "can")
