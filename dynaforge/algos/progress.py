"""A progress bar that counts what the algorithm counts."""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm


class TimestepProgressBar(BaseCallback):
    """Shows `num_timesteps` against the total, with time left.

    SB3's own bar adds `n_envs` a step and so over-counts when envs idle.
    """

    def _on_training_start(self) -> None:
        self._bar: tqdm[Any] = tqdm(total=self.locals["total_timesteps"] - self.model.num_timesteps, unit="step")
        self._seen = self.model.num_timesteps

    def _on_step(self) -> bool:
        self._bar.update(self.model.num_timesteps - self._seen)
        self._seen = self.model.num_timesteps
        return True

    def _on_training_end(self) -> None:
        self._bar.close()
