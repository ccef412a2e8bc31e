"""The env under SB3's algorithms, as the README says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from stable_baselines3 import PPO

from dynaforge.algos import FrontierGRPO


def test_frontier_grpo_takes_the_env_id_and_saves_and_loads(tmp_path: Path) -> None:
    model = FrontierGRPO("MlpPolicy", "DynaForge/Can-v0", n_groups=2, group_size=2, seed=0)
    model.learn(1)
    assert model.last_group_success is not None
    assert model.last_group_success.shape == (2, 2)
    model.save(tmp_path / "can")
    again = FrontierGRPO.load(tmp_path / "can")
    observation = np.zeros(model.observation_space.shape, np.float32)
    assert np.array_equal(
        model.predict(observation, deterministic=True)[0], again.predict(observation, deterministic=True)[0]
    )
    model.get_env().close()


def test_an_untrained_residual_leaves_the_planner_as_it_is() -> None:
    model = FrontierGRPO("MlpPolicy", "DynaForge/Can-v0", seed=0)
    observation = np.ones(model.observation_space.shape, np.float32)
    assert not model.predict(observation, deterministic=True)[0].any()
    model.get_env().close()


def test_ppo_learns_in_the_same_env() -> None:
    model = PPO("MlpPolicy", "DynaForge/Can-v0", gamma=1.0, n_steps=32, batch_size=32, seed=0, device="cpu")
    model.learn(32)
    assert model.num_timesteps == 32
    model.get_env().close()
