"""A pytest plugin: Stable-Baselines3's own tests meet FrontierGRPO wherever they say PPO.

Only the constructor is translated: `n_steps` becomes the cap of an episode, and what a critic needs is dropped.
"""

from __future__ import annotations

from typing import Any

import pytest
import stable_baselines3

from dynaforge.algos import FrontierGRPO

CRITIC = ("gamma", "gae_lambda", "ent_coef", "vf_coef", "normalize_advantage", "clip_range_vf")


class InPlaceOfPPO(FrontierGRPO):
    """FrontierGRPO for envs that report no success, some of which never end."""

    def __init__(self, policy: Any, env: Any, *args: Any, n_steps: int = 64, **options: Any) -> None:
        for name in CRITIC:
            options.pop(name, None)
        small = {"n_groups": 2, "group_size": 2, "group_filter": "mixed_return", "max_episode_steps": n_steps}
        super().__init__(policy, env, *args, **small | options)


stable_baselines3.PPO = InPlaceOfPPO


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests of PPO alone, by parameter or by name in their source."""
    kept = [item for item in items if _is_of_ppo(item)]
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = kept


def _is_of_ppo(item: Any) -> bool:
    params = getattr(getattr(item, "callspec", None), "params", {})
    classes = [value for value in params.values() if isinstance(value, type) and hasattr(value, "learn")]
    if classes:
        return InPlaceOfPPO in classes
    return "PPO" in item.function.__code__.co_names
