"""A digest of all that moved in an episode, put into the info of its last step."""

from __future__ import annotations

import hashlib
from functools import cache
from itertools import count
from typing import Any

import gymnasium as gym
import numpy as np

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import ControlStep, World
from dynaforge.sim import Condition, SceneState
from dynaforge.tasks import get_task


class TrajectoryHash:
    """Listens to a world and digests joint positions, object poses and object velocities bit by bit."""

    def __init__(self, world: World) -> None:
        world.listeners.append(self)
        self.restart()

    def restart(self) -> None:
        self._digest = hashlib.sha256()
        self.steps: list[ControlStep] = []

    def __call__(self, step: ControlStep) -> None:
        if not self.steps:
            self._add(step.before)
        self._add(step.after)
        self.steps.append(step)

    def _add(self, state: SceneState) -> None:
        self._digest.update(state.q.tobytes())
        for body in state.objects.values():
            for array in (body.pose.position, body.pose.rotation, body.velocity, body.angular_velocity):
                self._digest.update(array.tobytes())

    @property
    def hex(self) -> str:
        return self._digest.hexdigest()


class Traced(gym.Wrapper):
    """Adds `info["trajectory"]` at the end of each episode."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.trace = TrajectoryHash(env.unwrapped.world)

    def reset(self, **kwargs: Any):
        self.trace.restart()
        return self.env.reset(**kwargs)

    def step(self, action: np.ndarray):
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated:
            info["trajectory"] = self.trace.hex
        return observation, reward, terminated, truncated, info


def traced_env(**kwargs: Any) -> Traced:
    return Traced(ResidualEnv("can", **kwargs))


def condition(stratum: int, seed: int = 3) -> Condition:
    return get_task("can").conditions.draw(np.random.default_rng(seed), stratum, 8)


def action(k: int, size: int = 5) -> np.ndarray:
    """Return the residual of decision k: smooth, never zero, the same everywhere."""
    return (0.4 * np.sin(np.arange(1, size + 1) * (0.3 * k + 1.0))).astype(np.float32)


def run(env: Traced, which: Condition, *, scale: float = 1.0) -> tuple[str, dict[str, Any]]:
    """Run an episode with the actions of `action` and return its digest and last info."""
    env.reset(options={"condition": which})
    done, k, info = False, 0, {}
    while not done:
        _, _, done, _, info = env.step(scale * action(k, env.action_space.shape[0]))
        k += 1
    return info["trajectory"], info


@cache
def lifted() -> Condition:
    """Return the first condition of the slowest stratum whose can is lifted with the actions of `action`."""
    env = traced_env()
    found = next(which for seed in count() if run(env, which := condition(0, seed))[1]["is_success"])
    env.close()
    return found
