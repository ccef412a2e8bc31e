from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

import dynaforge
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.task_env import TaskEnv
from dynaforge.registration import ENV_NAMES, env_id, register_envs
from dynaforge.tasks import TASK_NAMES

assert dynaforge.__version__


def test_every_task_has_its_env_ids_and_every_id_its_task() -> None:
    assert set(ENV_NAMES) == set(TASK_NAMES)
    registered = {name for name in gymnasium.registry if name.startswith("DynaForge/")}
    assert registered == {f"DynaForge/{name}{kind}-v0" for name in ENV_NAMES.values() for kind in ("", "Task")}


@pytest.mark.parametrize("task", TASK_NAMES)
def test_an_id_makes_the_env_of_its_task(task: str) -> None:
    for name, kind in ((env_id(task), ResidualEnv), (env_id(task).replace("-v0", "Task-v0"), TaskEnv)):
        env = gymnasium.make(name)
        assert type(env.unwrapped) is kind
        assert env.unwrapped.task.name == task
        env.close()


def test_no_time_limit_stands_around_an_env() -> None:
    """Truncation would have Stable-Baselines3 add a bootstrapped value to the return of Eq. 6."""
    for name in gymnasium.registry:
        if name.startswith("DynaForge/"):
            assert gymnasium.spec(name).max_episode_steps is None


def test_importing_the_package_registers_without_loading_physics() -> None:
    code = "import dynaforge, sys; print(any(m in sys.modules for m in ('pybullet', 'torch', 'pinocchio', 'h5py')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "False"


def test_an_id_that_names_its_module_is_known_in_every_process() -> None:
    code = "import gymnasium; print(gymnasium.make('dynaforge:DynaForge/CanTask-v0').spec.id)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "DynaForge/CanTask-v0"


def test_registering_again_is_no_override() -> None:
    before = dict(gymnasium.registry)
    register_envs()  # a warning would fail this
    assert gymnasium.registry == before


def test_a_module_in_the_current_folder_stands_in_for_none_of_the_commands(tmp_path: Path) -> None:
    for name in ("json", "numpy", "random"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('imported from the current folder')")
    command = [sys.executable, "-m", "dynaforge", "list"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert "peg" in done.stdout


def test_a_misspelt_id_is_refused_with_the_close_match() -> None:
    with pytest.raises(gymnasium.error.NameNotFound, match="Did you mean: `Can`"):
        gymnasium.make("DynaForge/Cann-v0")


def test_the_default_gate_mode_of_the_registered_ids_is_skip() -> None:
    env = gymnasium.make("DynaForge/Can-v0")
    assert env.unwrapped.gate_mode == "skip"
    env.close()
