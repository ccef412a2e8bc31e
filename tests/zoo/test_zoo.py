from __future__ import annotations

import argparse
import inspect
import json
import os
import subprocess
import sys
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli.main import main
from dynaforge.training import model
from dynaforge.training.settings import known_algorithms, variants
from dynaforge.zoo import algorithm
from dynaforge.zoo import scripts as zoo
from dynaforge.zoo.flags import zoo_parser
from dynaforge.zoo.process import ZooProcess, _options_of
from dynaforge.zoo.refusals import check_algorithm


def run(*arguments: str) -> str:
    """Run the entry point and return the one line it ends with."""
    with pytest.raises(SystemExit) as ended:
        zoo.main(list(arguments))
    message = str(ended.value)
    assert "\n" not in message
    return message


def test_a_mistake_in_a_zoo_command_is_status_2_as_in_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--algo", "ppo", "--env", "cann"]) == 2
    assert capsys.readouterr().err == "dynaforge: no env 'cann'. Did you mean 'can'?\n"


@pytest.mark.parametrize("arguments", [[], ["trian", "--algo", "ppo"], ["--algo", "ppo"]])
def test_anything_but_a_script_of_the_zoo_is_refused(arguments: list[str]) -> None:
    assert "expected 'train', 'enjoy', 'record_video'" in run(*arguments)


def test_unknown_names_are_refused_with_the_closest_match() -> None:
    assert "Did you mean 'frontier_grpo'?" in run("train", "--algo", "frontier_gpro")
    assert "Did you mean 'DynaForge/Can-v0'?" in run("train", "--algo", "ppo", "--env", "DynaForge/Cann-v0")


def test_a_missing_configuration_file_is_named() -> None:
    assert "'nowhere.yml'" in run("train", "--algo", "ppo", "--env", "CartPole-v1", "-conf", "nowhere.yml")


ENTRY = "{n_timesteps: 100, policy: MlpPolicy, n_envs: 1%s}"
FILES = {
    "file": "",
    "broken.yml": "a: [1",
    "list.yml": "[1, 2]",
    "other.yml": f"Foo-v0: {ENTRY % ''}",
    "flat.yml": "CartPole-v1: 3",
    "short.yml": "CartPole-v1: {policy: MlpPolicy}",
    "unknown.yml": f"CartPole-v1: {ENTRY % ', group_sise: 4'}",
    "rate.yml": f"CartPole-v1: {ENTRY % ', clip_range_high: lin_x'}",
    "no.zip": "",
}
MISTAKES = {
    "": "name an env, as in: dynaforge train --algo frontier_grpo --env DynaForge/Can-v0",
    "-n 0": "-n is 0; it must be at least 1",
    "-n=-5": "-n is -5",
    "--seed=-2": "--seed is -2",
    "--seed 4294967296": "--seed is 4294967296",
    "-f file": "-f file is a file",
    "-i gone.zip --trusted": "-i gone.zip does not exist",
    "-i no.zip --trusted": "-i no.zip is no checkpoint",
    "-conf broken.yml": "broken.yml is no YAML",
    "-conf list.yml": "list.yml holds list",
    "-conf other.yml": "other.yml lists Foo-v0, and neither CartPole-v1",
    "-conf flat.yml": "flat.yml: CartPole-v1 holds int",
    "-conf short.yml": "CartPole-v1 lacks n_timesteps",
    "-conf unknown.yml": "no hyperparameter 'group_sise'. Did you mean 'group_size'?",
    "-conf rate.yml": "clip_range_high is 'lin_x'; write a number, or lin_NUMBER",
    "-conf folder": "-conf folder is a folder",
    "-conf no.such.package": "neither a file that ends in .yml or .py nor a package",
    "-params lerning_rate:1": "Did you mean 'learning_rate'?",
    "-params learning_rate:fast": "-params learning_rate:fast: name 'fast' is not defined; write NAME:VALUE",
    "-params learning_rate:": "is no pair; write NAME:VALUE",
    "-params learning_rate": "is no pair; write NAME:VALUE",
    "-params learning_rate:1/0": "division by zero",
    "-params learning_rate:float('nan')": "learning_rate is nan",
    "-params group_size:1": "group_size is 1, but must be at least 2",
    "--physics wide": "--physics is an argument of the env here: --env-kwargs \"physics:'wide'\".",
    "--reflex 30": '--env-kwargs "reflex:30"',
    "--env-kwargs foo:1": "unexpected keyword argument 'foo'",
}


@pytest.mark.parametrize("flags", MISTAKES)
def test_a_mistake_is_one_line_and_leaves_no_folder(
    flags: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_text(text)
    Path("folder").mkdir()
    before = sorted(tmp_path.rglob("*"))
    env = ["--env", "CartPole-v1", "--device", "cpu"] if flags else []
    assert MISTAKES[flags] in run("train", "--algo", "frontier_grpo", *env, *flags.split())
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("script", ["train", "enjoy", "record_video"])
def test_flags_are_read_as_the_script_reads_them(script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Read(Exception):  # noqa: N818 - no error
        pass

    def read(parser: argparse.ArgumentParser, *_: object) -> None:
        raise Read(parser)

    with monkeypatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_args", read)
        patch.setattr(sys, "argv", [script])
        with pytest.raises(Read) as reading:
            zoo._run(script)
    ours = zoo_parser(script)._option_string_actions
    for name, theirs in reading.value.args[0]._option_string_actions.items():
        assert ours[name].nargs == theirs.nargs, name
        assert ours[name].required == theirs.required, name
        if theirs.type in (int, float):
            said = run(script, name, "x")
            assert name in said
            assert "is 'x'; it must be a" in said
            assert ours[name].type("3") == 3


def test_a_slip_in_a_flag_is_reported_before_anything_heavy_is_imported() -> None:
    lines = (
        "train --foo",
        "train --algo ppo",
        "train --algo popo --env can",
        "enjoy -n x",
        "plot_train",
        "train x",
        "all_plots",
        "plot_from_file --trusted",
    )
    code = f"""
import sys
from dynaforge.zoo import scripts as zoo
for line in {lines!r}:
    try:
        zoo.main(line.split())
    except SystemExit as ended:
        assert "\\n" not in str(ended), ended
print([name for name in ("torch", "rl_zoo3", "pybullet", "matplotlib") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_no_script_of_the_zoo_leaves_a_trace_in_the_process() -> None:
    algorithm.register_with_zoo()
    from rl_zoo3.exp_manager import ExperimentManager
    from rl_zoo3.utils import StoreDict
    from stable_baselines3.common.base_class import BaseAlgorithm

    before = [dict(vars(owner)) for owner in (ExperimentManager, StoreDict, BaseAlgorithm)]
    with closing(ZooProcess("record_training", [], own_envs=True)):
        assert vars(BaseAlgorithm) != before[2]
    assert [dict(vars(owner)) for owner in (ExperimentManager, StoreDict, BaseAlgorithm)] == before


@pytest.mark.parametrize("algo", ["frontier_grpo", "ppo"])
def test_every_schedule_of_a_configuration_falls_to_zero_and_not_below(
    algo: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With `-n 100` a whole iteration overshoots the steps by far."""
    monkeypatch.chdir(tmp_path)
    own = ", n_groups: 2, group_size: 2, group_filter: mixed_return, clip_range_high: lin_0.28"
    sizes = own if algo == "frontier_grpo" else ", n_steps: 128, batch_size: 64"
    rest = f"{sizes}, learning_rate: lin_1e-3, clip_range: lin_0.2"
    Path("c.yml").write_text(f"CartPole-v1: {ENTRY % rest}")
    seen: dict[str, Any] = {}

    def look(manager: Any, model: Any) -> None:
        seen["model"] = model

    algorithm.register_with_zoo()
    from rl_zoo3.exp_manager import ExperimentManager

    monkeypatch.setattr(ExperimentManager, "save_trained_model", look)
    flags = [
        "--env",
        "CartPole-v1",
        "-n",
        "50",
        "-conf",
        "c.yml",
        "--eval-freq",
        "-1",
        "--device",
        "cpu",
        "--seed",
        "0",
    ]
    assert zoo.main(["train", "--algo", algo, *flags]) == 0
    model = seen["model"]
    assert model.num_timesteps > 50
    assert model.policy.optimizer.param_groups[0]["lr"] == 0.0
    assert model.clip_range(0.5) == 0.1
    assert algo == "ppo" or model.clip_range_high(0.5) == 0.14


@pytest.mark.parametrize("flags", [["-i", "a.zip"], ["--trained-agent=a.zip"], ["--trained", "a.zip"], ["-ia.zip"]])
def test_training_on_from_a_checkpoint_needs_trust(flags: list[str]) -> None:
    assert "a.zip can run code" in run("train", "--algo", "ppo", *flags)


@pytest.mark.parametrize("script", ["enjoy", "record_video"])
def test_playing_a_checkpoint_needs_trust(script: str) -> None:
    assert "--trusted" in run(script, "--algo", "ppo")


def test_playing_without_a_display_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    flags = ["--algo", "ppo", "--env", "DynaForge/Can-v0", "--trusted", "-f", "nowhere"]
    assert "DISPLAY is not set; add --no-render" in run("enjoy", *flags)


def test_a_missing_zoo_is_one_line_that_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "rl_zoo3"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Missing("rl_zoo3"), *sys.meta_path])
    message = run("train", "--algo", "frontier_grpo")
    assert "need rl_zoo3" in message
    assert "dynaforge[zoo]" in message


class Missing:
    """An import finder for which one package does not exist."""

    def __init__(self, package: str) -> None:
        self.package = package

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> None:
        if name.partition(".")[0] == self.package:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def test_registration_reaches_every_module_of_the_zoo() -> None:
    algorithm.register_with_zoo()
    from rl_zoo3 import enjoy, exp_manager, hyperparams_opt, train

    from dynaforge.algos import FrontierGRPO

    for module in (train, enjoy, exp_manager):
        assert module.ALGOS["frontier_grpo"] is module.ALGOS["grpo"] is FrontierGRPO
    assert set(algorithm.ALGORITHMS) <= set(hyperparams_opt.HYPERPARAMS_SAMPLER) & set(
        exp_manager.HYPERPARAMS_CONVERTER
    )


def test_our_hyperparameters_are_taken_only_where_they_speak_of_the_env() -> None:
    found = algorithm.config_file("frontier_grpo", "DynaForge/Can-v0")
    assert found is not None
    assert found.name == "frontier_grpo.yml"
    assert algorithm.config_file("frontier_grpo", "CartPole-v1") is not None  # by its default
    assert algorithm.config_file("ppo", "DynaForge/Can-v0") is not None
    assert algorithm.config_file("ppo", "CartPole-v1") is None  # the zoo has its own
    assert algorithm.config_file("sac", "DynaForge/Can-v0") is None


@pytest.mark.parametrize(
    ("flags", "own_vec_env", "own_config"),
    [
        (["--algo", "frontier_grpo", "--env", "DynaForge/Can-v0"], True, True),
        (["--algo", "frontier_grpo", "--env", "DynaForge/Can-v0", "--vec-env", "dummy"], False, True),
        (["--algo", "frontier_grpo", "--env", "DynaForge/Can-v0", "-conf", "setup.py"], True, False),
        (["--algo", "ppo", "--env", "CartPole-v1"], False, False),
    ],
)
def test_what_the_zoo_finds_in_the_process(
    flags: list[str], own_vec_env: bool, own_config: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    algorithm.register_with_zoo()
    from rl_zoo3.exp_manager import ExperimentManager

    from dynaforge.sampling.vector_env import SharedMemoryVecEnv

    found: dict[str, Any] = {}

    def look(script: str) -> None:
        found.update(script=script, argv=sys.argv, vec_env=ExperimentManager.default_vec_env_cls)
        raise KeyboardInterrupt

    monkeypatch.setattr(zoo, "_run", look)
    monkeypatch.chdir(tmp_path)
    Path("setup.py").touch()
    before = sys.argv
    with pytest.raises(KeyboardInterrupt):
        zoo.main(["train", *flags, "--trusted"])
    assert found["script"] == "train"
    assert found["vec_env"] is (SharedMemoryVecEnv if own_vec_env else None)
    ours = ["--conf-file", str(algorithm.config_file("frontier_grpo", "DynaForge/Can-v0"))]
    assert found["argv"] == ["dynaforge train", *flags, *(ours if own_config else [])]
    assert sys.argv is before
    assert ExperimentManager.default_vec_env_cls is None


ZOO_KEYS = {"n_timesteps", "n_envs", "env_kwargs", "env_wrapper", "vec_env_wrapper", "normalize", "callback"}


@pytest.mark.parametrize("algo", known_algorithms())
def test_every_configuration_file_is_of_an_algorithm_of_the_zoo_and_its_options_exist(algo: str) -> None:
    check_algorithm(algo)
    algorithm.register_with_zoo()
    from rl_zoo3 import ALGOS
    from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER

    assert ALGOS[algo] is model.ALGORITHMS[algo]
    assert algo in HYPERPARAMS_SAMPLER.keys() & HYPERPARAMS_CONVERTER.keys()
    constructor = set(_options_of(ALGOS[algo]))
    for env_id, options in yaml.safe_load(files("dynaforge.zoo_configs").joinpath(f"{algo}.yml").read_text()).items():
        assert set(options) <= constructor | ZOO_KEYS, env_id
        assert options["policy"] in ALGOS[algo].policy_aliases


def test_vanilla_differs_from_the_papers_frontier_grpo_by_strata_and_filter_alone() -> None:
    folder = files("dynaforge.zoo_configs")
    frontier, vanilla = (
        yaml.safe_load(folder.joinpath(f"{name}.yml").read_text()) for name in algorithm.OF_FRONTIER_GRPO
    )
    assert frontier.keys() == vanilla.keys()
    for env_id in frontier:
        frontier[env_id].pop("scale_learning_rate", None)
        wanted = frontier[env_id] | {"group_filter": "none", "stratified": False}
        assert vanilla[env_id] == wanted
    assert variants()["frontier_grpo"] == {"config": "frontier_grpo", "scale_learning_rate": None}


def test_sampled_hyperparameters_are_options_of_the_algorithm_and_its_policy() -> None:
    from dynaforge.algos import FrontierGRPO
    from dynaforge.algos.residual_sac import ResidualSAC

    trial = SimpleNamespace(
        suggest_float=lambda name, low, high, log=False: high, suggest_categorical=lambda name, choices: choices[0]
    )
    sampled = algorithm.sample_hyperparameters(trial, n_actions=7, n_envs=1, additional_args={})
    assert set(sampled) <= set(inspect.signature(FrontierGRPO.__init__).parameters)
    built = FrontierGRPO("MlpPolicy", "Pendulum-v1", group_filter="mixed_return", **sampled)
    assert sampled["policy_kwargs"]["log_std_init"] == -0.7
    assert [built.lr_schedule(progress) for progress in (1.0, 0.5, 0.0)] == pytest.approx([3e-3, 1.5e-3, 0.0])
    sampled = algorithm.sample_residual_sac(trial, n_actions=7, n_envs=1, additional_args={})
    rival = ResidualSAC("MlpPolicy", "Pendulum-v1", **sampled)
    assert (rival.update_ratio, rival.batch_size, rival.tau) == (1, 128, 0.02)
    assert rival.actor.log_std_init == -0.7


def zoo_process(folder: Path, *arguments: str) -> str:
    """Run a script in a process of its own, as a user does, and return what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "dynaforge.zoo", *arguments],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_zoo_trains_and_saves_frontier_grpo(tmp_path: Path) -> None:
    which = ["--algo", "frontier_grpo", "--env", "CartPole-v1", "-f", "logs", "--device", "cpu"]
    small = ["-params", "n_envs:2", "n_groups:2", "group_size:2", "group_filter:'mixed_return'"]
    trained = zoo_process(tmp_path, "train", *which, "-n", "150", "--seed", "1", "--num-threads", "1", *small)
    assert "zoo_configs/frontier_grpo.yml" in trained
    run_folder = tmp_path / "logs" / "frontier_grpo" / "CartPole-v1_1"
    assert (run_folder / "CartPole-v1.zip").is_file()
    assert (run_folder / "CartPole-v1" / "config.yml").is_file()


def test_zoo_trains_residual_sac_and_saves_its_policy(tmp_path: Path) -> None:
    which = [
        "--algo",
        "residual_sac",
        "--env",
        "DynaForge/Can-v0",
        "-f",
        "logs",
        "--device",
        "cpu",
        "--vec-env",
        "dummy",
    ]
    small = ["-params", "n_envs:1", "learning_starts:4", "batch_size:8", "buffer_size:100"]
    asked = ["-n", "24", "--seed", "1", "--num-threads", "1", "--eval-freq", "-1"]
    trained = zoo_process(tmp_path, "train", *which, *asked, *small)
    assert "zoo_configs/residual_sac.yml" in trained
    policy = tmp_path / "logs" / "residual_sac" / "DynaForge-Can-v0_1" / "policy.safetensors"
    assert MlpPolicyFile.load(policy, task="can").meta["algo"] == "residual_sac"
    assert "Loading" in zoo_process(tmp_path, "enjoy", *which[:-4], "-n", "4", "--no-render", "--trusted")


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("algo", ["frontier_grpo", "ppo"])
def test_the_flags_of_the_zoo_work_on_a_task(tmp_path: Path, algo: str) -> None:
    """Train with evaluation, continue, film, search; and `evaluate` accepts the policy that training leaves."""
    which = ["--algo", algo, "--env", "DynaForge/Can-v0", "-f", "logs", "--device", "cpu"]
    sizes = ["n_groups:4", "group_size:2", "group_filter:'none'"] if algo == "frontier_grpo" else ["n_steps:16"]
    small = ["--num-threads", "1", "--seed", "0", "--eval-episodes", "1", "-params", "n_envs:4", *sizes]
    asked = ["--eval-freq", "8", "--save-freq", "40", "-tb", "tensorboard", "--verbose", "0", "-P"]
    trained = zoo_process(tmp_path, "train", *which, "-n", "64", *asked, *small)
    first, second = (tmp_path / "logs" / algo / f"DynaForge-Can-v0_{k}" for k in (1, 2))
    policy = first / "policy.safetensors"
    assert f"--policy {policy.relative_to(tmp_path)}" in trained
    assert MlpPolicyFile.load(policy, task="can").meta["algo"] == algo
    assert (first / "evaluations.npz").is_file()
    measured = tmp_path / "measured.json"
    asked = ["--task", "can", "--generator", "residual", "--seeds", "1", "--attempts", "2", "--out", str(measured)]
    assert main(["evaluate", *asked, "--policy", str(policy)]) == 0
    assert len(json.loads(measured.read_text())["conditions"]) == 2

    agent = str(first / "DynaForge-Can-v0.zip")
    zoo_process(tmp_path, "train", *which, "-n", "64", "-i", agent, "--trusted", "--eval-freq", "-1", *small)
    assert (second / "policy.safetensors").read_bytes() != policy.read_bytes()

    enjoyed = zoo_process(tmp_path, "enjoy", *which, "-n", "120", "--no-render", "--trusted")
    assert "Loading" in enjoyed
    assert "Episode" in enjoyed

    kept = sorted(int(path.stem.split("_")[-2]) for path in first.glob("rl_model_*_steps.zip"))
    for chosen in (["--load-best"], ["--load-last-checkpoint"], ["--load-checkpoint", str(kept[0])]):
        short = [*which, "-n", "12", "--no-render", "--trusted", "--exp-id", "1"]
        assert "Loading" in zoo_process(tmp_path, "enjoy", *short, *chosen, "--reward-log", str(tmp_path / "rewards"))

    record = ["--algo", algo, "--env", "DynaForge/Can-v0", "-n", "4", "--deterministic", "--trusted"]
    zoo_process(tmp_path, "record_training", *record, "--exp-id", "2")  # finds logs by itself
    assert (second / "videos" / "training.mp4").stat().st_size > 1000

    zoo_process(tmp_path, "plot_train", "-a", algo, "-e", "DynaForge/Can-v0", "-f", "logs", "-y", "success", "-w", "2")
    monitors = [path.read_text().splitlines() for path in first.glob("*.monitor.csv")]
    assert all(rows[1] == "r,l,t,is_success" for rows in monitors)
    assert max(map(len, monitors)) > 2  # an episode ended in one of the envs

    filmed = ["--algo", algo, "--env", "DynaForge/Can-v0", "-f", "logs", "-n", "12", "-o", "films"]
    zoo_process(tmp_path, "record_video", *filmed, "--trusted")
    assert [path.stat().st_size > 1000 for path in (tmp_path / "films").glob("*.mp4")] == [True]

    search = ["-optimize", "--n-trials", "1", "--n-evaluations", "1", "--n-jobs", "1", "-n", "64"]
    assert "Number of finished trials" in zoo_process(tmp_path, "train", *which, *search, *small)
