"""Means at the rim of the action box: measured, penalised, squashed."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from small_models import envs, small, weights
from stable_baselines3.common.vec_env import DummyVecEnv

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policies import CriticFreePolicy
from dynaforge.algos.rim import has_rim, means_at_rim, reach, rim_penalty

OBS = gym.spaces.Box(-1.0, 1.0, (3,), np.float32)
BOX = gym.spaces.Box(np.array([-1.0, 0.0], np.float32), np.array([1.0, 4.0], np.float32))
MEANS = ([0.5, 2.0], [-0.995, 2.0], [0.0, 5.0], [-2.0, -1.0])
KINDS = [{}, {"use_sde": True}]


def policy_with_mean(mean: list[float], **kwargs) -> CriticFreePolicy:
    policy = CriticFreePolicy(OBS, BOX, lambda _: 1e-3, net_arch=[4], **kwargs)
    with th.no_grad():
        policy.action_net.bias.copy_(th.tensor(mean))
    return policy


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("mean", "at_rim", "penalty"),
    # the second component reaches from 0 to 4: 5 lies half of its half size outside, -1 as well
    zip(MEANS, (False, True, True, True), (0.0, 0.0, 0.25, 1.25), strict=True),
)
def test_rim_and_penalty_match_means_worked_by_hand(mean, at_rim, penalty, kind):
    policy = policy_with_mean(mean, **kind)
    if kind:
        policy.reset_noise(5)
    policy(th.zeros(5, 3))
    assert means_at_rim(policy).tolist() == 5 * [at_rim]
    np.testing.assert_allclose(rim_penalty(policy.get_distribution(th.zeros(3, 3)), BOX).detach(), 3 * [penalty])


def test_a_row_is_at_the_rim_if_any_component_is():
    policy = CriticFreePolicy(OBS, BOX, lambda _: 1e-3, net_arch=[])
    with th.no_grad():
        policy.action_net.weight.copy_(th.tensor([[1.0, 0.0, 0.0], [4.0, 0.0, 0.0]]))
    observations = th.zeros(4, 3)
    observations[:, 0] = th.tensor([0.2, 0.8, 1.0, 0.9])  # means (x, 4x), at the rim from 0.99 and 0.995
    policy(observations)
    assert means_at_rim(policy).tolist() == [False, False, True, False]


@pytest.mark.parametrize("kind", KINDS)
def test_a_squashed_mean_stays_within_the_box_and_starts_at_its_centre(kind, tmp_path):
    policy = CriticFreePolicy(OBS, BOX, lambda _: 1e-3, net_arch=[4], squash_mean=True, **kind)
    start, _ = policy.predict(np.ones((2, 3), np.float32), deterministic=True)
    np.testing.assert_array_equal(start, 2 * [[0.0, 2.0]])
    with th.no_grad():
        policy.action_net[0].bias.copy_(th.tensor([50.0, -0.5]))
    mean = policy.get_distribution(th.zeros(1, 3)).mode()[0].detach()
    np.testing.assert_allclose(mean, [1.0, 2.0 + 2.0 * np.tanh(-0.5)], rtol=1e-6)
    policy.save(str(tmp_path / "policy"))
    loaded = CriticFreePolicy.load(str(tmp_path / "policy"), device="cpu")
    assert loaded.squash_mean
    np.testing.assert_array_equal(loaded.get_distribution(th.zeros(1, 3)).mode()[0].detach(), mean)


class PushesOut(gym.Env):
    """The more the sampled action would lie beyond the bound, the better; clipped, there is nothing to see."""

    observation_space, action_space = OBS, gym.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.ones(3, np.float32), {}

    def step(self, action):
        return np.ones(3, np.float32), float(action[0]), True, False, {}


def furthest(**kwargs) -> float:
    options = {"learning_rate": 0.05, "group_filter": "none", "n_groups": 4, "group_size": 8} | kwargs
    model = small(DummyVecEnv([PushesOut] * 8), **options).learn(32 * 6)
    return float(reach(model.policy.get_distribution(th.ones(1, 3)), model.action_space).detach().max())


def test_penalty_and_squashing_keep_the_means_in_the_box():
    free = furthest() - 1.0
    assert free > 0.1
    assert furthest(rim_coef=100.0) - 1.0 < 0.3 * free
    assert furthest(policy_kwargs={"net_arch": [16], "squash_mean": True}) <= 1.0


def test_without_a_mean_outside_the_penalty_changes_nothing():
    plain, penalised = (small(envs(4), group_filter="none", rim_coef=c).learn(48) for c in (0.0, 10.0))
    assert all(np.array_equal(a, b) for a, b in zip(weights(plain), weights(penalised), strict=True))


def test_the_share_at_the_rim_is_logged_for_the_policy_that_acted(logged):
    model = small(envs(4), group_filter="none", n_epochs=1)
    with th.no_grad():
        model.policy.action_net.bias.fill_(-3.0)
    values = logged(model)
    model.learn(1)
    model.learn(1, reset_num_timesteps=False)
    assert values["train/rim_fraction"] == 1.0


class HalfGated(gym.Env):
    """Two steps: observation 0 with the gate closed, then observation 1 with it open if an episode's number is even."""

    observation_space, action_space = OBS, gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
    episodes = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.episodes = 0, self.episodes + 1
        return np.zeros(3, np.float32), {}

    def step(self, action):
        self.steps += 1
        gate = float(self.steps == 2 and self.episodes % 2 == 0)
        return np.ones(3, np.float32), float(action[0]), self.steps == 2, False, {"residual_mask": gate}


@pytest.mark.parametrize("exploration", ["stream", "job"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_share_at_the_rim_counts_decisions_with_an_effect_alone(kind, exploration, logged):
    policy_kwargs = {"net_arch": []}
    model = small(
        DummyVecEnv([HalfGated] * 3), group_filter="none", exploration=exploration, policy_kwargs=policy_kwargs, **kind
    )
    with th.no_grad():
        model.policy.action_net.weight.fill_(
            -1.0
        )  # the mean is 0 where the gate is closed, and -3 where it may be open
    values = logged(model)
    model.learn(1)
    assert 0 < model.rollout_buffer.mask.mean() < 0.5
    model.learn(1, reset_num_timesteps=False)
    assert values["train/rim_fraction"] == 1.0


def test_what_has_no_rim_is_neither_logged_nor_penalised(logged):
    discrete = small("CartPole-v1", n_groups=1, group_size=2, group_filter="mixed_return")
    values = logged(discrete)
    discrete.learn(1)
    discrete.learn(1, reset_num_timesteps=False)
    assert "train/rim_fraction" not in values
    assert not has_rim(discrete.policy)
    squashed = {"policy_kwargs": {"squash_output": True}, "use_sde": True}
    assert not has_rim(small(envs(1), **squashed).policy)
    with pytest.raises(ValueError, match="rim_coef needs a bounded Box"):
        small(envs(1), rim_coef=1.0, **squashed)
    with pytest.raises(ValueError, match="rim_coef needs a bounded Box"):
        FrontierGRPO("MlpPolicy", "CartPole-v1", rim_coef=1.0, device="cpu")
    with pytest.raises(ValueError, match="squash_mean needs a bounded Box"):
        FrontierGRPO("MlpPolicy", "CartPole-v1", policy_kwargs={"squash_mean": True}, device="cpu")
    with pytest.raises(ValueError, match="exclude each other"):
        small(envs(1), use_sde=True, policy_kwargs={"squash_output": True, "squash_mean": True})
