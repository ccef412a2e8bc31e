"""Our algorithms in rl_zoo3, with default hyperparameters and a range to search them in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from dynaforge.training import settings
from dynaforge.zoo.flags import SCRIPTS

OF_FRONTIER_GRPO = ("frontier_grpo", "grpo")
"""Names under which rl_zoo3 finds FrontierGRPO; "grpo" is the vanilla variant by its zoo_configs file alone."""

ALGORITHMS = (*OF_FRONTIER_GRPO, "residual_sac")
"""Names of our algorithms in rl_zoo3: the files of zoo_configs, but for those of algorithms that it has itself."""

NET_ARCHS = {"small": [64, 64], "medium": [128, 128], "large": [256, 256]}


def register_with_zoo() -> None:
    """Make our algorithms known to rl_zoo3, for training, loading and hyperparameter search.

    rl_zoo3 imports its dictionaries by name in several modules, so they are changed in place, never replaced.

    Raises:
        SystemExit: rl_zoo3, or a package that its scripts need, is not installed.
    """
    try:
        from rl_zoo3 import ALGOS
        from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER
    except ModuleNotFoundError as error:
        raise SystemExit(
            f"dynaforge: {', '.join(SCRIPTS)} need {error.name}, missing here; pip install 'dynaforge[zoo]'"
        ) from error
    from dynaforge.training import model

    for name in ALGORITHMS:
        ALGOS[name] = model.ALGORITHMS[name]
        group = name in OF_FRONTIER_GRPO
        HYPERPARAMS_SAMPLER[name] = sample_hyperparameters if group else sample_residual_sac
        HYPERPARAMS_CONVERTER[name] = convert_hyperparameters if group else convert_residual_sac


def config_file(algo: str, env_id: str) -> Path | None:
    """Return the installed hyperparameter file of an algorithm, or None where rl_zoo3's own is the better choice.

    Ours are used where they list the env, or a default for all envs; rl_zoo3 has files of its own for PPO and others.
    """
    path = settings.config_file(algo)
    if path is None or settings.entry_of(yaml.safe_load(path.read_text(encoding="utf-8")), env_id) is None:
        return None
    return path


def sample_hyperparameters(trial: Any, n_actions: int, n_envs: int, additional_args: dict[str, Any]) -> dict[str, Any]:
    """Sample the options of FrontierGRPO for an Optuna trial, as rl_zoo3's samplers do.

    `log_std_init` ranges from -4.5, for the weights of gSDE, to -0.7, for white noise on each component.

    Args:
        trial: The Optuna trial.
        n_actions: Components of an action; not used.
        n_envs: Envs of the vectorised env; not used.
        additional_args: What rl_zoo3 passes to samplers of off-policy algorithms; not used.

    Returns:
        Arguments of the constructor.
    """
    return convert_hyperparameters(
        {
            "learning_rate": trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True),
            "n_epochs": trial.suggest_categorical("n_epochs", [1, 2, 4]),
            "group_size": trial.suggest_categorical("group_size", [4, 8, 16]),
            "max_grad_norm": trial.suggest_float("max_grad_norm", 0.3, 2.0),
            "log_std_init": trial.suggest_float("log_std_init", -4.5, -0.7),
            "net_arch": trial.suggest_categorical("net_arch", sorted(NET_ARCHS)),
        }
    )


def convert_hyperparameters(sampled: dict[str, Any]) -> dict[str, Any]:
    """Turn sampled values into constructor arguments: the learning rate decays, noise and net_arch go to the policy."""
    from stable_baselines3.common.utils import LinearSchedule

    options = convert_residual_sac(sampled)
    decaying = LinearSchedule(start=options.pop("learning_rate"), end=0.0, end_fraction=1.0)
    return {**options, "learning_rate": decaying}


def sample_residual_sac(trial: Any, n_actions: int, n_envs: int, additional_args: dict[str, Any]) -> dict[str, Any]:
    """Sample the options of ResidualSAC for an Optuna trial.

    Args:
        trial: The Optuna trial.
        n_actions: Components of an action; not used, as are the others.
        n_envs: Envs of the vectorised env.
        additional_args: What rl_zoo3 passes to samplers of off-policy algorithms.

    Returns:
        Arguments of the constructor.
    """
    return convert_residual_sac(
        {
            "learning_rate": trial.suggest_float("learning_rate", 1e-4, 1e-3, log=True),
            "update_ratio": trial.suggest_categorical("update_ratio", [1, 2, 4]),
            "batch_size": trial.suggest_categorical("batch_size", [128, 256, 512]),
            "tau": trial.suggest_float("tau", 0.002, 0.02, log=True),
            "log_std_init": trial.suggest_float("log_std_init", -3.0, -0.7),
            "net_arch": trial.suggest_categorical("net_arch", sorted(NET_ARCHS)),
        }
    )


def convert_residual_sac(sampled: dict[str, Any]) -> dict[str, Any]:
    """Turn sampled values into constructor arguments: noise and net_arch go to the policy."""
    options = dict(sampled)
    policy = {"log_std_init": options.pop("log_std_init"), "net_arch": NET_ARCHS[options.pop("net_arch")]}
    return {**options, "policy_kwargs": policy}
