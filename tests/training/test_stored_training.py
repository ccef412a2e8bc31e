from __future__ import annotations

from pathlib import Path

import gymnasium as gym
from stable_baselines3.common.vec_env import DummyVecEnv

from dynaforge.tasks import get_task
from dynaforge.training.stored_training import HISTORY, StoredTraining


def training(folder: Path) -> StoredTraining:
    """PPO on an env whose episodes are longer than the test, with updates of 8 steps."""
    env = DummyVecEnv([lambda: gym.make("Pendulum-v1")])
    return StoredTraining(
        folder, get_task("can"), env, algo="ppo", seed=0, n_steps=8, batch_size=8, n_epochs=1, n_envs=1
    )


def test_a_training_that_was_killed_resumes_at_its_checkpoint(tmp_path: Path) -> None:
    """A kill between the two writes of a save leaves a history that is ahead of the checkpoint."""
    first = training(tmp_path)
    assert not first.resumed

    def save_after_two(updates: int) -> bool:
        if updates == 2:
            first.save()
        return True

    first.learn(24, save_after_two)
    first.history.save(tmp_path / HISTORY)
    assert len(first.history) == 3

    second = training(tmp_path)
    assert second.resumed
    assert second.model.num_timesteps == 16
    assert second.history.timesteps == [8, 16]
    updates: list[int] = []
    second.learn(24, lambda made: updates.append(made) is None)
    assert second.history.timesteps == [8, 16, 24]
    assert updates == [2, 3]
    second.learn(24, lambda made: updates.append(made) is None)
    assert updates == [2, 3], "nothing is left to train"
