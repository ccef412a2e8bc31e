from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch as th

from dynaforge.algos.policies import CriticFreeMultiInputPolicy, CriticFreePolicy, renew_noise

OBS = gym.spaces.Box(-1.0, 1.0, (5,), np.float32)
ACT = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)


def make(**kwargs) -> CriticFreePolicy:
    return CriticFreePolicy(OBS, ACT, lambda _: 1e-3, **kwargs)


def test_no_parameter_belongs_to_a_critic():
    policy = make(net_arch={"pi": [8], "vf": [32, 32]}, share_features_extractor=False)
    assert {name.split(".")[0] for name, _ in policy.named_parameters()} == {"mlp_extractor", "action_net", "log_std"}
    assert sum(p.numel() for p in policy.parameters()) == (5 * 8 + 8) + (8 * 2 + 2) + 2
    assert not list(policy.mlp_extractor.value_net.parameters())


def test_default_network_is_128_128():
    assert [tuple(m.weight.shape) for m in make().mlp_extractor.policy_net if hasattr(m, "weight")] == [
        (128, 5),
        (128, 128),
    ]


def test_untrained_deterministic_action_is_exactly_zero():
    action, _ = make().predict(np.random.default_rng(0).normal(size=(6, 5)).astype(np.float32), deterministic=True)
    assert (action == 0.0).all()


def test_sigma_is_fixed_at_a_third_unless_asked():
    policy = make()
    np.testing.assert_allclose(policy.log_std.exp().detach(), 0.3, rtol=1e-6)
    assert not policy.log_std.requires_grad
    assert all(p is not policy.log_std for group in policy.optimizer.param_groups for p in group["params"])
    assert make(learn_std=True).log_std.requires_grad


def test_samples_spread_as_sigma_says():
    actions, _, _ = make()(th.zeros(20_000, 5))
    assert actions.std().item() == pytest.approx(0.3, rel=0.03)


def test_forward_and_evaluate_agree_and_values_are_zero():
    policy, obs = make(), th.randn(7, 5)
    actions, values, log_prob = policy(obs)
    again, evaluated, entropy = policy.evaluate_actions(obs, actions)
    th.testing.assert_close(log_prob, evaluated)
    assert entropy.shape == (7,)
    assert values.shape == again.shape == policy.predict_values(obs).shape == (7, 1)
    assert not values.any()


def test_saved_policy_acts_the_same(tmp_path):
    policy = make(net_arch=[16], learn_std=True)
    th.nn.init.normal_(policy.action_net.weight)
    policy.save(str(tmp_path / "policy"))
    loaded = CriticFreePolicy.load(str(tmp_path / "policy"), device="cpu")
    obs = np.ones(5, np.float32)
    np.testing.assert_array_equal(
        policy.predict(obs, deterministic=True)[0], loaded.predict(obs, deterministic=True)[0]
    )
    assert loaded.learn_std


def test_dict_observations_and_discrete_actions():
    spaces = gym.spaces.Dict({"a": OBS, "b": gym.spaces.Discrete(3)})
    policy = CriticFreeMultiInputPolicy(spaces, gym.spaces.Discrete(4), lambda _: 1e-3)
    action, _ = policy.predict({"a": np.zeros(5, np.float32), "b": np.array(1)})
    assert 0 <= action < 4
    assert policy.predict_values({"a": th.zeros(3, 5), "b": th.zeros(3)}).shape == (3, 1)


def test_renewing_noise_changes_only_the_rows_named():
    policy = make(use_sde=True)
    policy.reset_noise(4)
    before = policy.action_dist.exploration_matrices.clone()
    renew_noise(policy, np.array([1, 3]))
    changed = (policy.action_dist.exploration_matrices != before).flatten(1).any(dim=1)
    assert changed.tolist() == [False, True, False, True]
