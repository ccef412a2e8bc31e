"""rl_zoo3's scripts on user-defined tasks, and on folders of strangers."""

from __future__ import annotations

import itertools
import os
import sys
import zipfile
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv
from test_zoo import run, zoo_process

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.sim.setting import Setting
from dynaforge.tasks import get_task
from dynaforge.training.settings import hyperparameters
from dynaforge.zoo import algorithm, process
from dynaforge.zoo import scripts as zoo


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Hold what rl_zoo3 would have been started with."""
    found: list[str] = []
    monkeypatch.setattr(zoo, "_run", lambda script: found.extend(sys.argv))
    return found


@pytest.mark.parametrize("script", ["train", "enjoy", "record_video", "record_training"])
@pytest.mark.parametrize(
    ("given", "env"),
    [
        ("can", "DynaForge/Can-v0"),
        ("ToyCar", "DynaForge/ToyCar-v0"),
        ("dynaforge:DynaForge/Can-v0", "DynaForge/Can-v0"),
        ("dynaforge/cantask-v0", "DynaForge/CanTask-v0"),
        ("ball.py", "DynaForge/Ball-v0"),
    ],
)
def test_rl_zoo3_is_told_the_id_of_whatever_names_a_task(
    ball: Path, script: str, given: str, env: str, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ball.parent)
    zoo.main([script, "--algo", "frontier_grpo", "--env", given, "--trusted", *["--no-render"] * (script == "enjoy")])
    assert asked[asked.index(env) - 1] == "--env"


def test_a_package_that_is_a_task_file_registers_its_envs(
    ball: Path, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(ball.parent)
    zoo.main(["train", "--algo", "ppo", "--env", "DynaForge/Ball-v0", "--gym-packages", "ball"])
    assert "DynaForge/Ball-v0" in asked
    assert "--gym-packages bull: No module named 'bull'" in run("train", "--gym-packages", "bull")


def test_an_unnamed_file_of_a_task_is_offered_and_not_run(ball: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ball.parent)
    assert "give that file instead" in run("train", "--algo", "ppo", "--env", "DynaForge/Ball-v0")
    assert "ball" not in sys.modules


@pytest.mark.parametrize("algo", ["frontier_grpo", "grpo", "ppo"])
@pytest.mark.parametrize("given", ["ball.py", "peach"])
def test_train_takes_the_settings_that_forge_and_compare_take(
    ball: Path, algo: str, given: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    algorithm.register_with_zoo()
    from rl_zoo3.exp_manager import ExperimentManager

    taken: dict[str, Any] = {}

    def look(script: str) -> None:
        flags = dict(itertools.pairwise(sys.argv))  # the last of a flag counts
        env, config = flags["--env"], flags["--conf-file"]
        manager: Any = ExperimentManager.__new__(ExperimentManager)
        manager.__dict__.update(algo=algo, config=config, _is_atari=False, storage=None, custom_hyperparams=None)
        manager.env_name, manager.env_kwargs = EnvironmentName(env), {}
        taken.update(manager.read_hyperparameters()[0])
        assert manager.env_name.gym_id == env

    from huggingface_sb3 import EnvironmentName

    monkeypatch.setattr(zoo, "_run", look)
    monkeypatch.chdir(ball.parent)
    zoo.main(["train", "--algo", algo, "--env", given])
    assert taken == hyperparameters(algo, given)


@pytest.mark.parametrize("agent", ["", "logs/agent.zip"])
def test_statistics_of_a_run_are_not_unpickled_unasked(
    tmp_path: Path, agent: str, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """rl_zoo3 looks for them in the folder where it is started, even where no run is gone on with."""
    monkeypatch.chdir(tmp_path)
    folder = Path(os.path.dirname(agent)) / "DynaForge-Can-v0"
    folder.mkdir(parents=True)
    (folder / "vecnormalize.pkl").touch()
    if agent:
        zipfile.ZipFile(agent, "w").close()
    which = ["train", "--algo", "ppo", "--env", "can", *(["-i", agent] if agent else [])]
    assert "can run code" in run(*which)
    assert not asked
    zoo.main([*which, "--trusted"])
    assert asked


def test_a_policy_is_of_the_setting_of_its_envs_which_are_closed_when_it_is_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    env_name = SimpleNamespace(gym_id="DynaForge/Can-v0")
    manager = SimpleNamespace(algo="ppo", seed=0, save_path=str(tmp_path), env_name=env_name)
    model, saved = SimpleNamespace(_n_updates=0), []
    monkeypatch.setattr(
        "dynaforge.training.model.policy_file",
        lambda model, task, **_: saved.append(task.setting) or SimpleNamespace(save=lambda path: None),
    )
    made = DummyVecEnv([partial(gym.make, "DynaForge/Can-v0", reflex="strict", physics="fixed")])
    env = process._noting_the_task(lambda manager: made)(manager)
    env.close()
    made.envs = []
    process._saving_the_policy(lambda manager, model: None)(manager, model)
    assert saved == [Setting(reflex="strict", physics="fixed")]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_zoo_trains_plays_and_films_a_task_of_ones_own(ball: Path) -> None:
    which = ["--algo", "frontier_grpo", "--env", "ball.py", "-f", "logs"]
    small = ["--device", "cpu", "--num-threads", "1", "-n", "16", "--eval-episodes", "1", "--eval-freq", "8"]
    small += ["-params", "n_envs:2", "n_groups:2", "group_size:2"]
    for workers in ([], ["--vec-env", "subproc"]):
        zoo_process(ball.parent, "train", *which, *small, *workers)
    run_folder = ball.parent / "logs" / "frontier_grpo" / "DynaForge-Ball-v0_2"
    assert MlpPolicyFile.load(run_folder / "policy.safetensors", task=get_task(str(ball))).task == "ball"
    assert "Loading" in zoo_process(ball.parent, "enjoy", *which, "-n", "20", "--no-render", "--trusted")
    zoo_process(ball.parent, "record_video", *which, "-n", "4", "-o", "films", "--trusted")
    assert list((ball.parent / "films").glob("*.mp4"))
