"""Small models on small envs, for the tests of FrontierGRPO."""

from __future__ import annotations

from functools import partial

import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv
from toy_envs import MatchEnv

from dynaforge.algos import FrontierGRPO


def envs(n: int, **kwargs) -> DummyVecEnv:
    return DummyVecEnv([partial(MatchEnv, **kwargs)] * n)


def small(env, policy: str = "MlpPolicy", **kwargs) -> FrontierGRPO:
    options = {"n_groups": 4, "group_size": 4, "seed": 0, "device": "cpu", "policy_kwargs": {"net_arch": [16]}}
    return FrontierGRPO(policy, env, **(options | kwargs))


def weights(model) -> list[np.ndarray]:
    return [p.detach().numpy().copy() for p in model.policy.parameters()]


def equal(a, b) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
