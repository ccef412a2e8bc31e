from __future__ import annotations

import argparse
import inspect
import json
from pathlib import Path

import pytest
from stable_baselines3.common.utils import FloatSchedule

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli import training
from dynaforge.cli.main import main
from dynaforge.cli.training import build_model, hyperparameters
from dynaforge.cli.zoo import config_file
from dynaforge.demos import DemonstrationDataset
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.evaluation import TrainingHistory


@pytest.mark.timeout(170)
def test_forge_ends_with_demonstrations_policy_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    small = hyperparameters("frontier_grpo", "can") | {"n_groups": 4, "group_size": 2, "n_envs": 4}
    monkeypatch.setattr(training, "hyperparameters", lambda algo, task, changes=None: small)
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


def test_forge_builds_the_model_that_train_builds(tmp_path: Path) -> None:
    exp_manager = pytest.importorskip("rl_zoo3.exp_manager")
    from dynaforge.cli.zoo import register_with_zoo

    register_with_zoo()
    manager = exp_manager.ExperimentManager(
        argparse.Namespace(), "frontier_grpo", "DynaForge/Can-v0", str(tmp_path),
        config=str(config_file("frontier_grpo", "DynaForge/Can-v0")), verbose=0,
    )  # fmt: skip
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
