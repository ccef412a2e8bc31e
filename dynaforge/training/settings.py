"""The one place that decides which hyperparameters `forge`, `train` and `compare` train a task with."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from dynaforge.registration import TASK_FILES, env_id, task_named
from dynaforge.tasks import get_task

SETTINGS_FOR_OWN_TASKS = "DynaForge/Can-v0"
"""The env whose settings a user-defined task takes when no file lists it."""

RUN_SETTINGS = ("n_timesteps", "n_envs", "policy")


def config_file(algo: str) -> Path | None:
    """Return the file of zoo_configs for an algorithm, or None."""
    path = Path(str(files("dynaforge.zoo_configs").joinpath(f"{algo}.yml")))
    return path if path.is_file() else None


def entry_of(listed: Mapping[str, Any], env: str) -> str | None:
    """Return the name of the entry of a hyperparameter file that applies to an env, or None if none does.

    That is the env's own entry; else, for the residual env of a user-defined task, that of `SETTINGS_FOR_OWN_TASKS`;
    else the file's default for all envs.

    Args:
        listed: The content of the file.
        env: Env id.
    """
    task = task_named(env)
    own = task in TASK_FILES and env == env_id(task)
    candidates = (env, SETTINGS_FOR_OWN_TASKS, "default") if own else (env, "default")
    return next((name for name in candidates if name in listed), None)


def hyperparameters(algo: str, task: str, changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Read an entry of zoo_configs.

    Args:
        algo: Name of the file.
        task: Task name, env id or task file.
        changes: Settings that differ from it; None leaves a setting to the algorithm's own default.

    Raises:
        ValueError: No file for the algorithm, or no entry for the task.
    """
    known = known_algorithms()
    path = config_file(algo) if algo in known else None
    if path is None:
        raise ValueError(f"No zoo_configs/{algo}.yml for algorithm {algo!r}; known are {', '.join(known)}.")
    listed = yaml.safe_load(path.read_text(encoding="utf-8"))
    env = env_id(get_task(task).name)
    entry = entry_of(listed, env)
    if entry in (None, "default"):
        raise ValueError(
            f"{path} lists neither {env!r} nor {SETTINGS_FOR_OWN_TASKS!r}, which stands in for tasks of your own."
        )
    changes = changes or {}
    left_out = {name for name, value in changes.items() if value is None}
    return {name: value for name, value in (listed[entry] | dict(changes)).items() if name not in left_out}


def recommended(env: str, algo: str = "frontier_grpo", **changes: Any) -> dict[str, Any]:
    """Return the settings with which `dynaforge train` builds a model for an env, as arguments of its class.

    `FrontierGRPO("MlpPolicy", env, **recommended(env))`, `PPO("MlpPolicy", env, **recommended(env, "ppo"))`. What the
    file says besides, how many envs to collect in and for how many steps, is in `hyperparameters`.

    Args:
        env: Env id, task name or task file.
        algo: Name of a file in zoo_configs.
        changes: Settings that differ from it; None leaves a setting to the algorithm's own default.

    Raises:
        ValueError: No file for the algorithm, or no entry for the env.
    """
    return model_arguments(hyperparameters(algo, env, changes))


def model_arguments(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of an entry of zoo_configs that a model's constructor takes, besides policy and env."""
    return {name: _scheduled(value) for name, value in settings.items() if name not in RUN_SETTINGS}


def _scheduled(value: Any) -> Any:
    """Turn "lin_1e-3" into a linear decay to zero over the run, as rl_zoo3 does."""
    if isinstance(value, str) and value.startswith("lin_"):
        from stable_baselines3.common.utils import LinearSchedule

        return LinearSchedule(start=float(value.removeprefix("lin_")), end=0.0, end_fraction=1.0)
    return value


def variants() -> dict[str, dict[str, Any]]:
    """Read zoo_configs/compare.yml: the name of each variant of `compare`, and its file and settings."""
    text = files("dynaforge.zoo_configs").joinpath("compare.yml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def known_algorithms() -> list[str]:
    """Return the algorithms that zoo_configs has a file for."""
    names = sorted(path.name for path in files("dynaforge.zoo_configs").iterdir())
    return [name.removesuffix(".yml") for name in names if name.endswith(".yml") and name != "compare.yml"]
