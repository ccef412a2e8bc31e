"""The env and the model with which `forge` and `compare` train, built with the hyperparameters of zoo_configs."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.algos.residual_sac import ResidualSAC
from dynaforge.envs.residual_env import GateMode, ResidualEnv
from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions
from dynaforge.sampling.vector_env import SharedMemoryVecEnv
from dynaforge.tasks import Task
from dynaforge.training.settings import hyperparameters, model_arguments

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "frontier_grpo": FrontierGRPO,
    "grpo": FrontierGRPO,
    "ppo": PPO,
    "residual_sac": ResidualSAC,
}


def training_env(task: Task, n_envs: int, *, algo: str = "frontier_grpo", cores: int = 2) -> VecEnv:
    """Make the vectorised env to collect in.

    On several cores there are two workers per core, so that one with less to do leaves its share of the core to the
    others. FrontierGRPO collects in mask mode, where no env's long lift stalls the others: it ignores steps without
    effect, and with `timesteps="gated"` counts as under "skip"; PPO would learn from them, and SAC count them. On one
    core everything runs in this process, where nothing can stall.

    Args:
        task: The task.
        n_envs: Number of envs.
        algo: Name of a file in zoo_configs.
        cores: Cores to collect on.
    """
    if cores == 1:
        return DummyVecEnv([partial(ResidualEnv, task)] * n_envs)
    gate_mode: GateMode = "mask" if ALGORITHMS[algo] is FrontierGRPO else "skip"
    return SharedMemoryVecEnv([partial(ResidualEnv, task, gate_mode=gate_mode)] * n_envs, n_workers=2 * cores)


def build_model(task: str, env: Any, *, algo: str = "frontier_grpo", seed: int = 0, **changes: Any) -> BaseAlgorithm:
    """Build the model that zoo_configs describes.

    Args:
        task: Task name, env id or task file.
        env: The env to train in.
        algo: Name of a file in zoo_configs.
        seed: Training seed.
        changes: Hyperparameters to override.
    """
    settings = hyperparameters(algo, task, changes)
    return ALGORITHMS[algo](settings["policy"], env, seed=seed, device="cpu", **model_arguments(settings))


@contextlib.contextmanager
def decaying_within(model: BaseAlgorithm, used: Callable[[], float]) -> Iterator[None]:
    """Let every schedule of a model follow the larger of two shares: of the steps taken, and of a budget used.

    Stable-Baselines3 knows only the steps. How many of them a time budget allows is not known beforehand, so that a
    training that ends by the clock would end at, say, half its learning rate.

    Args:
        model: The model that learns inside the `with` block.
        used: Returns the share of the budget used so far, 0 to 1.
    """
    by_steps = model._update_current_progress_remaining

    def by_steps_and_budget(num_timesteps: int, total_timesteps: int) -> None:
        by_steps(num_timesteps, total_timesteps)
        model._current_progress_remaining = max(0.0, min(model._current_progress_remaining, 1.0 - used()))

    vars(model)[by_steps.__name__] = by_steps_and_budget
    try:
        yield
    finally:
        del vars(model)[by_steps.__name__]


def policy_file(model: BaseAlgorithm, task: Task, *, algo: str, seed: int, updates: int) -> MlpPolicyFile:
    """Take the policy out of a model, with a note of how it was trained.

    Args:
        model: The model.
        task: The task, in the setting that it was trained in.
        algo: Name of the file in zoo_configs that it was trained with.
        seed: Training seed.
        updates: Updates made.
    """
    meta = {"algo": algo, "seed": seed, "updates": updates, "versions": package_versions()}
    return MlpPolicyFile.of(model, task=task, meta=meta)


def save_model(model: BaseAlgorithm, path: Path) -> None:
    """Write a model as an SB3 zip file, whole or not at all."""
    buffer = io.BytesIO()
    model.save(buffer)
    atomic_write(path, buffer.getvalue())
