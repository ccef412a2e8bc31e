from __future__ import annotations

import argparse
import inspect
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import FloatSchedule, LinearSchedule

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli import forge
from dynaforge.cli.commands import COMMANDS
from dynaforge.cli.main import main
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import GaveUp, PlannerOnly
from dynaforge.tasks import Outcome, get_task
from dynaforge.training import forge as forge_training
from dynaforge.training import model as training
from dynaforge.training.forge_folder import ForgeFolder, asked_for
from dynaforge.training.history import STRATA, TrainingHistory
from dynaforge.training.model import build_model
from dynaforge.training.monitor import TimeLimit
from dynaforge.training.settings import hyperparameters
from dynaforge.zoo.algorithm import config_file


@pytest.mark.timeout(170)
def test_forge_ends_with_demonstrations_policy_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    small = hyperparameters("frontier_grpo", "can") | {"n_groups": 4, "group_size": 2, "n_envs": 4}
    for module in (training, forge, forge_training):
        monkeypatch.setattr(module, "hyperparameters", lambda algo, task, changes=None: small)
    out = tmp_path / "run"
    options = ["--updates", "1", "--demos", "2", "--attempts", "2", "--budget", "5m", "--workers", "1"]
    assert main(["forge", "--task", "can", *options, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "planner only" in printed
    assert "with residual" in printed
    policy = MlpPolicyFile.load(out / "policy.safetensors", task="can")
    dataset = DemonstrationDataset(out / "demos")
    assert len(dataset) >= 2
    assert all(e.success and e.meta["policy_hash"] == policy.digest for e in dataset)
    assert len(dataset.attempts()) >= len(dataset)
    assert json.loads((out / "result.json").read_text())["updates"] == 1
    history = TrainingHistory.load(out / "history.json")
    assert sum(history.trials[0]) == 8
    assert sum(history.groups[0]) == 4
    assert "<video" in (out / "report.html").read_text()

    before = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    assert main(["forge", "--task", "can", *options, "--out", str(out)]) == 0
    assert f"{out} holds this run: finished" in capsys.readouterr().out
    after = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    assert after == before
    changed = ["--updates", "2", "--seed", "7", *options[2:]]
    assert main(["forge", "--task", "can", *changed, "--out", str(out)]) == 2
    refused = capsys.readouterr().err
    assert "holds a run with seed 0, updates 1, now seed 7, updates 2 is asked for" in refused
    assert refused.count("\n") == 1


@pytest.mark.parametrize("content", ["{", "[]", "[" * 100_000])
def test_a_damaged_folder_is_refused_in_one_line(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "forge.json").write_text(content)
    assert main(["forge", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["forge.json"]


def test_without_a_folder_the_latest_run_that_waits_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def opened(*arguments: str) -> ForgeFolder:
        options = COMMANDS["forge"].read("forge", arguments)
        return ForgeFolder.of(options.out, asked_for(options))

    first = opened()
    assert first.path == Path("runs/can-1")
    assert first.stage("planner", lambda: {"successes": 3}) == {"successes": 3}
    again = opened("--workers", "1")
    assert again.path == first.path
    assert again.resumed
    assert again.stage("planner", lambda: pytest.fail("made again")) == {"successes": 3}
    assert opened("--seed", "1").path == Path("runs/can-2")
    assert opened("--seed", "1").path == Path("runs/can-2")
    assert opened().path == Path("runs/can-3")
    assert opened("--reflex", "strict").path == Path("runs/can-4")
    assert opened("--reflex", "strict").resumed
    with pytest.raises(ValueError, match=r"run with setting reflex contact, .*, now setting reflex 30 N, "):
        opened("--reflex", "30", "--out", "runs/can-1")
    shutil.rmtree("runs/can-4")
    Path("runs/can-3/report.html").touch()
    assert opened().path == Path("runs/can-4")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_forge_that_is_killed_again_and_again_comes_to_its_end(tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = ["--updates", "2", "--demos", "2", "--attempts", "2", "--budget", "20m", "--workers", "2"]
    command = [sys.executable, "-m", "dynaforge", "forge", "--task", "can", *options, "--out", str(out)]
    updates = []
    for seconds in (4, 8, 15, 22, 30, 40, 50, 60, 400):
        try:
            done = subprocess.run(command, timeout=seconds, check=False, capture_output=True, text=True)  # SIGKILL
        except subprocess.TimeoutExpired:
            history = out / "history.json"
            updates.append(len(TrainingHistory.load(history)) if history.is_file() else 0)
            continue
        assert done.returncode in (0, 1), done.stderr  # 1: too few demonstrations
        break
    assert updates == sorted(updates)
    assert len(TrainingHistory.load(out / "history.json")) == 2
    assert DemonstrationDataset(out / "demos").attempts()
    assert (out / "report.html").is_file()


@pytest.mark.parametrize("algorithm", [FrontierGRPO, PPO])
def test_the_rate_decays_over_the_larger_of_step_share_and_budget_share(algorithm: type[Any], tmp_path: Path) -> None:
    options = {"n_groups": 1, "group_size": 2, "group_filter": "none"} if algorithm is FrontierGRPO else {"n_steps": 64}
    start, shares, rates = 1e-3, iter([0.0, 0.2, 0.9, 1.0]), []
    rate = LinearSchedule(start, 0.0, 1.0)
    model = algorithm("MlpPolicy", "CartPole-v1", learning_rate=rate, seed=0, device="cpu", **options)

    class Watch(BaseCallback):
        def _on_rollout_start(self) -> None:
            rates.append(self.model.policy.optimizer.param_groups[0]["lr"] / start)

        def _on_step(self) -> bool:
            return self.num_timesteps < 5000 and len(rates) < 5

    with training.decaying_within(model, lambda: next(shares)):
        model.learn(10_000, callback=Watch())
        training.save_model(model, tmp_path / "m.zip")  # plain data: nothing of the budget is in it
    assert rates[0] == 1.0
    assert 0.9 < rates[1] < 1.0  # by steps
    assert rates[2:] == pytest.approx([0.8, 0.1, 0.0])
    assert algorithm.load(tmp_path / "m.zip").lr_schedule(0.5) == start / 2


def test_a_training_that_uses_its_budget_up_ends_at_a_rate_near_zero() -> None:
    history = TrainingHistory()
    limit = TimeLimit(history, seconds=100.0, updates=4)
    used = []
    for update in range(4):
        assert limit(update)
        for rows, row in ((history.successes, [0] * STRATA), (history.trials, [1] * STRATA)):
            rows.append(row)
        history.timesteps.append(update)  # the update is collected, its optimisation is next
        used.append(limit.used())
    assert used == pytest.approx([0.0, 0.25, 0.5, 0.75], abs=0.01)
    limit.close()
    history.collect_wall, history.optimize_wall = [60.0], [39.5]
    late = TimeLimit(history, seconds=100.0)  # resumed: what was spent counts
    assert late.used() == pytest.approx(0.995, abs=0.003)
    late.close()


def test_forge_builds_the_model_that_train_builds(tmp_path: Path) -> None:
    exp_manager = pytest.importorskip("rl_zoo3.exp_manager")
    from dynaforge.zoo.algorithm import register_with_zoo

    register_with_zoo()
    manager = exp_manager.ExperimentManager(
        argparse.Namespace(),
        "frontier_grpo",
        "DynaForge/Can-v0",
        str(tmp_path),
        config=str(config_file("frontier_grpo", "DynaForge/Can-v0")),
        verbose=0,
    )
    zoo, _ = manager.read_hyperparameters()
    zoo, _, _, _ = manager._preprocess_hyperparams(zoo)
    env = ResidualEnv("can")
    ours = build_model("can", env, seed=0)
    policy = zoo.pop("policy")
    theirs = FrontierGRPO(policy, env, seed=0, **{name: value for name, value in zoo.items() if name != "n_envs"})
    env.close()
    for name in inspect.signature(FrontierGRPO).parameters:
        mine, other = getattr(ours, name, None), getattr(theirs, name, None)
        if name in ("learning_rate", "clip_range", "clip_range_high"):
            assert float(FloatSchedule(mine)(1.0)) == float(FloatSchedule(other)(1.0)), name
        elif isinstance(mine, int | float | str | dict | type(None)):
            assert mine == other, name
    for a, b in zip(ours.policy.parameters(), theirs.policy.parameters(), strict=True):
        assert a.equal(b)


def test_collecting_that_gets_nowhere_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    task = get_task("can")
    condition = next(task.conditions.stream("train"))
    outcome = Outcome(success=False, checkpoint=1, failure="dropped", phase="lift")
    lost = Attempt(condition=condition, generator="residual", outcome=outcome, duration=1.0)

    def give_up(*_: object, on_attempt: Callable[[Attempt], None], **__: object) -> None:
        on_attempt(lost)
        raise GaveUp("No success", [lost])

    monkeypatch.setattr(forge, "collect", give_up)
    dataset = forge._collect(task, PlannerOnly(), tmp_path / "demos", argparse.Namespace(demos=2, workers=1))
    assert len(dataset) == 0
    assert "only 0 successes in 1 attempts: dropped (1). Train longer" in capsys.readouterr().out
