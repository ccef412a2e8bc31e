"""An env whose episodes say what they are: which condition, and how far."""

from __future__ import annotations

from dataclasses import dataclass

import gymnasium as gym
import numpy as np


@dataclass(frozen=True)
class Length:
    name: int
    steps: int


class CountingEnv(gym.Env):
    """Episode of `condition.steps` steps; observation (name, time), reward the action; -1 is no condition."""

    observation_space = gym.spaces.Box(-1e9, 1e9, (2,), np.float64)
    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, bad: str = "") -> None:
        self.bad = bad
        self.taken = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.condition = (options or {}).get("condition", Length(-1, 2))
        self.t = 0
        return self._obs(), {}

    def step(self, action):
        self.taken += 1
        self.t += 1
        done = self.t >= self.condition.steps
        reward = float("inf") if self.bad == "reward" else float(action[0])
        return self._obs(), reward, done, False, {"is_success": self.condition.name % 2 == 0} if done else {}

    def _obs(self):
        return np.array([self.condition.name, np.nan if self.bad == "obs" and self.t == 1 else self.t])
