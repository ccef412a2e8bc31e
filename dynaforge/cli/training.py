"""Training a residual with the hyperparameters of zoo_configs, as `forge` does it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from dynaforge.algos import FrontierGRPO
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.vector_env import SharedMemoryVecEnv
from dynaforge.registration import env_id
from dynaforge.tasks import Task

BARS = "▁▂▃▄▅▆▇█"
LIKE = "DynaForge/Can-v0"  # whose settings a task that is not listed takes
NOT_THE_MODEL = ("n_timesteps", "n_envs", "policy")


def hyperparameters(algo: str, task: str) -> dict[str, Any]:
    """Read an entry of zoo_configs, the same that `dynaforge train` reads.

    Raises:
        ValueError: No file for the algorithm, or no entry for the task.
    """
    path = Path(str(files("dynaforge.zoo_configs").joinpath(f"{algo}.yml")))
    if not path.is_file():
        raise ValueError(f"No zoo_configs/{algo}.yml for algorithm {algo!r}.")
    listed = yaml.safe_load(path.read_text(encoding="utf-8"))
    entry = listed.get(env_id(task), listed.get(LIKE))
    if entry is None:
        raise ValueError(f"{path} lists neither {env_id(task)!r} nor {LIKE!r}, which stands in for tasks of your own.")
    return dict(entry)


def training_env(task: Task, n_envs: int, *, cores: int = 2) -> SharedMemoryVecEnv:
    """Make the vectorised env to collect in.

    Mask mode, so that no env's long lift stalls the others; two workers a core, so that one with less to do leaves
    its share of the core to the others.
    """
    return SharedMemoryVecEnv([partial(ResidualEnv, task, gate_mode="mask")] * n_envs, n_workers=2 * cores)


def build_model(task: str, env: Any, *, algo: str = "frontier_grpo", seed: int = 0, **changes: Any) -> FrontierGRPO:
    """Build the model that zoo_configs describes.

    Args:
        task: Task name.
        env: The env to train in.
        algo: Which file of zoo_configs.
        seed: Training seed.
        changes: Hyperparameters to override.
    """
    options = hyperparameters(algo, task) | changes
    policy = options["policy"]
    kept = {name: value for name, value in options.items() if name not in NOT_THE_MODEL}
    return FrontierGRPO(policy, env, seed=seed, **kept)


@dataclass(slots=True)
class History:
    """What training leaves behind, one entry an update.

    Attributes:
        success: Successes, shape (N, K) each, strata in order.
        seconds: Wall seconds since the start.
        timesteps: Environment steps since the start.
        optimizer_steps: Optimizer steps since the start.
    """

    success: list[np.ndarray[Any, Any]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    timesteps: list[int] = field(default_factory=list)
    optimizer_steps: list[int] = field(default_factory=list)

    def rates(self) -> np.ndarray[Any, Any]:
        """Success rate of every stratum at every update, shape (U, N)."""
        return np.array([s.mean(axis=1) for s in self.success])


class TrainingMonitor(BaseCallback):
    """Keeps the history, shows a bar with time left and success by stratum, and stops when the time is up.

    Args:
        history: Filled as training goes.
        seconds: Wall time allowed; no update is begun that would not end in time.
        updates: Updates allowed; None for no limit.
        on_update: Called with the number of updates after each.
        quiet: Show nothing.
    """

    def __init__(
        self, history: History, *, seconds: float, updates: int | None = None,
        on_update: Callable[[int], None] = lambda update: None, quiet: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.history = history
        self._seconds = seconds
        self._updates = updates
        self._on_update = on_update
        self._quiet = quiet
        self._goes_on = True

    def _on_training_start(self) -> None:
        self._start = self._last = time.monotonic()
        self._longest = 0.0
        self._bar = tqdm(
            total=round(self._seconds), unit="s", disable=self._quiet,
            bar_format="training {percentage:3.0f}%|{bar:20}| {n:.0f}/{total_fmt} s {postfix}",
        )  # fmt: skip

    def _on_step(self) -> bool:
        return self._goes_on

    def _on_rollout_end(self) -> None:
        now, model, history = time.monotonic(), self.model, self.history
        assert isinstance(model, FrontierGRPO)
        self._longest = max(self._longest, now - self._last)
        self._last = now
        history.success.append(np.array(model.last_group_success))
        history.seconds.append(now - self._start)
        history.timesteps.append(self.num_timesteps)
        history.optimizer_steps.append(model.optimizer_steps)
        done = len(history.success)
        rates = history.success[-1].mean(axis=1)
        strata = "".join(BARS[round(float(rate) * (len(BARS) - 1))] for rate in rates)
        self._bar.set_postfix_str(f"update {done}, success {rates.mean():4.0%}, easy {strata} hard")
        self._bar.update(now - self._start - self._bar.n)
        self._on_update(done)
        time_is_up = now - self._start + self._longest > self._seconds
        self._goes_on = not time_is_up and (self._updates is None or done < self._updates)

    def _on_training_end(self) -> None:
        self._bar.close()
