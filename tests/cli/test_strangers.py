"""Folders and files may come from anybody: reading one runs no code that it brings along."""

from __future__ import annotations

import ast
import base64
import json
import pickle
import subprocess
import sys
import warnings
import zipfile
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest

import dynaforge
from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli.main import main
from dynaforge.demos.dataset import FORMAT
from dynaforge.demos.episode_file import FORMAT_VERSION
from dynaforge.sim.setting import Setting
from dynaforge.training import run as runs
from dynaforge.training import run_process
from dynaforge.training.ray_runs import MadeRun
from dynaforge.training.run_spec import Evaluation, RunSpec
from dynaforge.training.stored_training import CHECKPOINT
from dynaforge.zoo import scripts as zoo

ON_DATASETS = (["info"], ["verify"], ["verify", "--replay"], ["render"], ["view"], ["export", "--format", "robomimic"])


@pytest.fixture
def canary(tmp_path: Path) -> Path:
    return tmp_path / "canary"


class Trap:
    """Whoever unpickles it, or runs its text, leaves a file."""

    def __init__(self, canary: Path) -> None:
        self.text = f"open({str(canary)!r}, 'w').close()"

    def __reduce__(self) -> tuple[Any, ...]:
        return exec, (self.text,)


@pytest.mark.parametrize("command", ON_DATASETS, ids=" ".join)
@pytest.mark.parametrize(
    "task", ["evil", "evil.py", "./evil.py", "ABSOLUTE", "../data/evil.py", "dynaforge.cli", "Can"]
)
def test_a_dataset_makes_nothing_be_imported(
    tmp_path: Path,
    canary: Path,
    command: list[str],
    task: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = dataset(tmp_path / "data", str(tmp_path / "data" / "evil.py") if task == "ABSOLUTE" else task)
    (folder / "evil.py").write_text(Trap(canary).text)
    monkeypatch.chdir(folder)
    assert main([command[0], str(folder), *command[1:]]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert "evil" not in sys.modules
    assert not canary.exists()
    assert sorted(path.name for path in folder.iterdir()) == ["dataset.json", "evil.py", "generators.json"]


def dataset(folder: Path, task: str) -> Path:
    folder.mkdir()
    marker = {"format": FORMAT, "version": FORMAT_VERSION, "task": task}
    (folder / "dataset.json").write_text(json.dumps(marker))
    source = {"policy": "", "task_definition": "0" * 16, "task_file": "evil.py"}
    (folder / "generators.json").write_text(json.dumps({"planner_only": source}))
    return folder


def checkpoint(path: Path, canary: Path) -> Path:
    """Write a pickle in every shape that a loader of checkpoints knows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    bomb = pickle.dumps(Trap(canary))
    if path.suffix != ".zip":
        path.write_bytes(bomb)
        return path
    encoded = base64.b64encode(cloudpickle.dumps(Trap(canary))).decode()
    data = {"policy_class": {":type:": "<class 'object'>", ":serialized:": encoded}}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps(data))
        archive.writestr("policy.pth", bomb)
    return path


def test_the_checkpoint_of_a_stranger_springs_where_it_is_loaded(tmp_path: Path, canary: Path) -> None:
    with pytest.raises(pickle.UnpicklingError), warnings.catch_warnings(action="ignore"):
        FrontierGRPO.load(checkpoint(tmp_path / "model.zip", canary))
    assert canary.exists()


@pytest.mark.parametrize("script", ["enjoy", "record_video", "record_training", "train"])
def test_rl_zoo3_loads_nothing_of_a_log_folder_unasked(
    tmp_path: Path, canary: Path, script: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "logs" / "ppo" / "DynaForge-Can-v0_1"
    agent = checkpoint(run / "DynaForge-Can-v0.zip", canary)
    text = f"!!python/object/apply:exec [{Trap(canary).text!r}]"
    for name in ("args.yml", "config.yml", "vecnormalize.pkl", "obs_rms.pkl"):
        path = checkpoint(run / "DynaForge-Can-v0" / name, canary)
        if name.endswith("yml"):
            path.write_text(text)
    monkeypatch.chdir(run)
    more = ["-i", str(agent)] if script == "train" else ["--no-render"] * (script == "enjoy")
    with pytest.raises(SystemExit, match="--trusted"):
        zoo.main([script, "--algo", "ppo", "--env", "DynaForge/Can-v0", "-f", str(tmp_path / "logs"), *more])
    with pytest.raises(SystemExit, match="--trusted"):  # the statistics, which lie where it was started
        zoo.main(["train", "--algo", "ppo", "--env", "can", "-f", str(tmp_path / "logs")])
    assert not canary.exists()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_workers_of_rl_zoo3_import_nothing_of_the_current_folder(tmp_path: Path, canary: Path) -> None:
    for name in ("multiprocessing", "json", "numpy", "custom_envs"):
        (tmp_path / f"{name}.py").write_text(Trap(canary).text)
    which = ["train", "--algo", "ppo", "--env", "can", "-f", "logs", "--vec-env", "subproc", "--eval-freq", "-1"]
    small = ["-n", "8", "--device", "cpu", "-params", "n_envs:2", "n_steps:4", "batch_size:8"]
    command = [sys.executable, "-P", "-m", "dynaforge", *which, *small]  # as the installed command: -P
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    assert not canary.exists()


def ppo_run(changes: dict[str, int], folder: Path) -> RunSpec:
    return RunSpec(
        task="can",
        variant="ppo",
        algo="ppo",
        changes=changes,
        seed=0,
        steps=1,
        evaluation=Evaluation("val", 1, 1),
        folder=folder,
        setting=Setting(),
    )


def test_a_comparison_goes_on_from_no_pickle(tmp_path: Path, canary: Path) -> None:
    spec = ppo_run({"n_envs": 1, "n_steps": 512}, tmp_path / "run")
    checkpoint(spec.folder / CHECKPOINT, canary)
    with pytest.raises(ValueError, match="is no checkpoint of this run"):
        runs.train(spec)
    assert not canary.exists()


def test_a_comparison_writes_its_log_through_no_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def end(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    mine = tmp_path / "mine"
    mine.write_text("years of work")
    spec = ppo_run({}, tmp_path / "run")
    spec.folder.mkdir()
    (spec.folder / "log.txt").symlink_to(mine)
    monkeypatch.setattr(run_process.subprocess, "Popen", end)
    with pytest.raises(KeyboardInterrupt):
        run_process.start_run(spec)
    assert mine.read_text() == "years of work"


def test_a_run_from_a_cluster_is_written_through_no_link(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.write_text("years of work")
    for status, name in ((1, "log.txt"), (0, "exam.json")):
        spec = ppo_run({}, tmp_path / name)
        spec.folder.mkdir()
        (spec.folder / name).symlink_to(mine)
        MadeRun(spec, status, {name: b"{}"}).store()
        assert (spec.folder / name).read_bytes() == b"{}"
        assert not (spec.folder / name).is_symlink()
    assert mine.read_text() == "years of work"


@pytest.mark.slow
def test_a_comparison_does_not_look_at_a_model_of_sb3(tmp_path: Path, canary: Path) -> None:
    spec = ppo_run({"n_envs": 8}, tmp_path / "run")
    checkpoint(spec.folder / "model.zip", canary)
    runs.train(spec)
    assert spec.finished
    assert not canary.exists()


def test_policies_and_packs_are_no_pickles(tmp_path: Path, canary: Path) -> None:
    with pytest.raises(ValueError, match="is no dynaforge policy file"):
        MlpPolicyFile.load(checkpoint(tmp_path / "policy.safetensors", canary))
    np.save(tmp_path / "bomb.npy", np.array([Trap(canary)], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="allow_pickle=False"):
        np.load(tmp_path / "bomb.npy")  # as `Pack` does
    assert not canary.exists()


# What runs code, by the file that calls it: pipes to this program's own workers; names that are written in the program;
# and what a user names on the command line to be run.
OWN_WORKERS = {"sampling/vector_pool.py", "sampling/vector_worker.py", "sampling/processes.py"}
WRITTEN_HERE = {
    "benchmarks/suite.py",
    "cli/main.py",
    "zoo/scripts.py",
    "demos/exporters/__init__.py",
    "planning/lazy_pyplot.py",
    "__init__.py",
    "generators/__init__.py",
    "reports/extras.py",
    "tasks/__init__.py",
}
NAMED_BY_USERS = {"zoo/envs.py", "generators/learner.py", "tasks/user_code.py"}
RUNS_CODE = {
    "pickle.load",
    "pickle.loads",
    "Unpickler",
    "cloudpickle.load",
    "cloudpickle.loads",
    "th.load",
    "torch.load",
    "exec",
    "eval",
    "yaml.load",
    "yaml.full_load",
    "yaml.unsafe_load",
    "import_module",
    "importlib.import_module",
    "__import__",
    "builtins.__import__",
    "runpy.run_module",
    "runpy.run_path",
    "VecNormalize.load",
}


def test_no_other_part_of_the_package_runs_what_it_reads() -> None:
    package = Path(dynaforge.__file__).parent
    found = set()
    for path in package.rglob("*.py"):
        calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        pickled = any(keyword.arg == "allow_pickle" for call in calls for keyword in call.keywords)
        if pickled or any(ast.unparse(call.func) in RUNS_CODE for call in calls):
            found.add(path.relative_to(package).as_posix())
    assert found <= OWN_WORKERS | WRITTEN_HERE | NAMED_BY_USERS
    assert {"tasks/user_code.py", "sampling/vector_worker.py"} <= found
