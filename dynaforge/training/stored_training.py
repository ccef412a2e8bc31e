"""A training that is stored as it proceeds, so that the same call resumes it after any interruption."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from stable_baselines3.common.vec_env import VecEnv

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.tasks import Task
from dynaforge.training.checkpoint import load_checkpoint, save_checkpoint
from dynaforge.training.history import TrainingHistory
from dynaforge.training.model import build_model, policy_file
from dynaforge.training.monitor import TrainingMonitor

CHECKPOINT = "checkpoint.safetensors"
HISTORY = "history.json"


class StoredTraining:
    """A model in training, and the folder where its training checkpoint and history are stored.

    Args:
        folder: Where they are stored; what an earlier call left there is resumed.
        task: The task.
        env: The env to collect in.
        algo: Name of a file in zoo_configs.
        seed: Training seed.
        changes: Settings in which the training differs from that file.

    Attributes:
        model: The model.
        history: One row per update.
        resumed: Whether an earlier call's training is resumed.

    Raises:
        ValueError: The training checkpoint or the history is damaged, or belongs to another model.
    """

    def __init__(self, folder: Path, task: Task, env: VecEnv, *, algo: str, seed: int, **changes: Any) -> None:
        self._folder, self._task, self._algo, self._seed = folder, task, algo, seed
        self.model = build_model(task.name, env, algo=algo, seed=seed, **changes)
        self.history = TrainingHistory()
        self.resumed = self.checkpoint.is_file()
        if self.resumed:
            load_checkpoint(self.model, self.checkpoint, seed=seed)
            self.history = TrainingHistory.load(folder / HISTORY).up_to(self.model.num_timesteps)

    @property
    def checkpoint(self) -> Path:
        """The file of the training checkpoint."""
        return self._folder / CHECKPOINT

    def learn(self, timesteps: int, between_updates: Callable[[int], bool]) -> None:
        """Train up to a number of environment steps, those of earlier calls included.

        Args:
            timesteps: Environment steps; the update under way is finished.
            between_updates: See `TrainingMonitor`.
        """
        left = timesteps - self.model.num_timesteps
        if left > 0:
            monitor = TrainingMonitor(self.history, self._task.conditions, between_updates)
            self.model.learn(left, callback=monitor, reset_num_timesteps=not self.resumed)

    def policy(self) -> MlpPolicyFile:
        """Return the policy as it is now."""
        updates = len(self.history)
        return policy_file(self.model, self._task, algo=self._algo, seed=self._seed, updates=updates)

    def save(self) -> None:
        """Write history and training checkpoint.

        The history comes first: `up_to` shortens a history that is ahead of its training checkpoint, while one that is
        behind it would lack rows for good.
        """
        self.history.save(self._folder / HISTORY)
        save_checkpoint(self.model, self.checkpoint)
