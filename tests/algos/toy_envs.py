"""Small envs that the algorithm's tests run on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np


@dataclass(frozen=True)
class Target:
    offset: float
    difficulty: float

    @property
    def id(self) -> str:
        return f"target-{self.offset:.6f}-{self.difficulty:.6f}"


class TargetSampler:
    """Strata of difficulty: the harder, the smaller the tolerance."""

    def draw(self, rng: np.random.Generator, stratum: int | None = None, n_strata: int = 1) -> Target:
        low, width = (0.0, 1.0) if stratum is None else (stratum / n_strata, 1.0 / n_strata)
        difficulty = low + width * rng.random()
        return Target(float(rng.uniform(-1.0, 1.0)), float(difficulty))

    def reset_kwargs(self, condition: Target) -> dict[str, Any]:
        return {"options": {"condition": condition}}


class MatchEnv(gym.Env):
    """Two gated decisions must on average meet the observed offset; a third, ungated one has no effect."""

    observation_space = gym.spaces.Box(-1.0, 1.0, (3,), np.float32)
    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, *, dict_obs: bool = False, nan_at: str = "", short_when_easy: bool = False) -> None:
        self.condition_sampler = TargetSampler()
        self._nan_at, self._short = nan_at, short_when_easy
        self._dict_obs = dict_obs
        self.log: list[str] = []  # ids of the conditions this env ran
        self.steps = 0
        if dict_obs:
            self.observation_space = gym.spaces.Dict({"a": self.observation_space, "b": self.observation_space})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        given = (options or {}).get("condition")
        self.condition = given or self.condition_sampler.draw(self.np_random)
        if given:
            self.log.append(given.id)
        self._t, self._moved = 0, 0.0
        return self._obs(), {"condition_id": self.condition.id}

    def step(self, action):
        assert action.shape == (1,)
        self.steps += 1
        gated = self._t < 2
        self._moved += float(action[0]) / 2.0 if gated else 0.0
        self._t += 1
        done = self._t == (1 if self._short and self.condition.difficulty < 0.5 else 3)
        info: dict[str, Any] = {"residual_mask": 1.0 if gated else 0.0}
        reward = 0.0
        if done:
            error = abs(self._moved - 0.8 * self.condition.offset)
            success = error < 0.5 - 0.38 * self.condition.difficulty
            reward = 1.0 if success else 0.5 * (error < 0.6)
            info |= {"is_success": success, "condition_id": self.condition.id}
        if self._nan_at == "reward":
            reward = float("nan")
        return self._obs(), float(reward), done, False, info

    def _obs(self):
        obs = np.array([self.condition.offset, self.condition.difficulty, self._t / 3.0], np.float32)
        if self._nan_at == "obs" and self._t == 1:
            obs[1] = np.nan
        return {"a": obs, "b": -obs} if self._dict_obs else obs


class EndlessEnv(gym.Env):
    """Never ends; the observation counts steps."""

    observation_space = gym.spaces.Box(0.0, np.inf, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        self._t = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self._t += 1
        return np.full(1, self._t, np.float32), float(action), False, False, {}
