"""Figures of training: the cost of an update against PPO's, and the share of two cores that simulates."""

from __future__ import annotations

import time
from functools import partial
from statistics import median
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv

from dynaforge.algos import FrontierGRPO
from dynaforge.benchmarks.figure import Figure, spread, tracked
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.sampling.vector_env import SharedMemoryVecEnv
from dynaforge.tasks import Task
from dynaforge.training.model import build_model
from dynaforge.training.settings import hyperparameters

MAX_TRAINER_RATIO = 0.6  # of CPU per transition and epoch, over PPO's
MIN_SHARE = 0.8  # of two cores' time, inside the workers' env.step
CORES = 2
LENGTH = 16  # steps of an episode without physics


class RandomEnv(gym.Env[Any, Any]):
    """An env without physics: random observations, and episodes of fixed length with random outcome.

    Args:
        observation_space, action_space: Those of the task's env.
    """

    def __init__(self, observation_space: gym.Space[Any], action_space: gym.Space[Any]) -> None:
        self.observation_space, self.action_space = observation_space, action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._left = LENGTH
        return self._observation(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._left -= 1
        done = self._left == 0
        success = done and bool(self.np_random.random() < 0.5)
        return self._observation(), float(success), done, False, {"is_success": success} if done else {}

    def _observation(self) -> Any:
        return self.np_random.standard_normal(self.observation_space.shape or ()).astype(np.float32)


class TimedEnv(ResidualEnv):
    """An env that counts the CPU seconds of its process that pass inside `step`."""

    cpu = 0.0

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        start = time.process_time()
        result = super().step(action)
        self.cpu += time.process_time() - start
        return result


def trainer(task: Task, *, rounds: int = 5) -> list[Figure]:
    """Compare the CPU time of an update with PPO's, which takes turns with it.

    Both have the same number of transitions, network, batch size and epochs.
    """
    env = ResidualEnv(task)
    random_env = partial(RandomEnv, env.observation_space, env.action_space)
    env.close()
    same: dict[str, Any] = {"learning_rate": 1e-6, "n_epochs": 4, "batch_size": 512, "seed": 0, "device": "cpu"}
    policy = {"net_arch": [128, 128]}
    ours: OnPolicyAlgorithm = FrontierGRPO(
        "MlpPolicy", DummyVecEnv([random_env] * 16), group_filter="none", policy_kwargs=policy, **same
    )
    theirs = PPO("MlpPolicy", DummyVecEnv([random_env] * 16), n_steps=8 * LENGTH, policy_kwargs=policy, **same)
    for model in (ours, theirs):
        model.learn(1)
    seconds: dict[str, list[float]] = {"frontier_grpo": [], "ppo": []}
    for _ in tracked(range(2 * rounds), "trainer", total=2 * rounds):
        for name, model in (("frontier_grpo", ours), ("ppo", theirs)):
            start = time.process_time()
            model.train()
            seconds[name].append((time.process_time() - start) / (4 * 128 * LENGTH))
    ratio = [a / b for a, b in zip(seconds["frontier_grpo"], seconds["ppo"], strict=True)]
    measured = (
        f"{spread(ratio)}: {1e6 * median(seconds['frontier_grpo']):.1f} us, PPO {1e6 * median(seconds['ppo']):.1f}"
    )
    return [
        Figure(
            title="trainer CPU per transition and epoch over PPO's",
            target="<= 0.6",
            measured=measured,
            ok=median(ratio) <= MAX_TRAINER_RATIO,
            raw={"cpu_seconds": seconds},
        )
    ]


def collection(task: Task, *, rounds: int = 5) -> list[Figure]:
    """Measure the share of two cores' time that is spent inside the workers' `env.step` while collecting."""
    settings = hyperparameters("frontier_grpo", task.name)
    env = SharedMemoryVecEnv([partial(TimedEnv, task, gate_mode="mask")] * settings["n_envs"], n_workers=2 * CORES)
    shares = []
    try:
        model = build_model(task.name, env)
        assert isinstance(model, OnPolicyAlgorithm)
        _, callback = model._setup_learn(10**9, None)
        for _ in tracked(range(rounds), "collection", total=rounds):
            before, start = sum(env.get_attr("cpu")), time.perf_counter()
            model.collect_rollouts(env, callback, model.rollout_buffer, model.n_steps)
            wall = time.perf_counter() - start
            shares.append((sum(env.get_attr("cpu")) - before) / (CORES * wall))
    finally:
        env.close()
    return [
        Figure(
            title=f"collection: share of {CORES} cores inside env.step, {settings['n_envs']} envs, {2 * CORES} workers",
            target=">= 0.8",
            measured=spread(shares),
            ok=median(shares) >= MIN_SHARE,
            raw={"share": shares},
        )
    ]
