"""Stable-Baselines3 policies without a critic: groups are compared with themselves, so no value is estimated."""

from __future__ import annotations

import math
import warnings
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.distributions import StateDependentNoiseDistribution
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor, FlattenExtractor, NatureCNN
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from torch import nn

from dynaforge.algos.rim import WithinBox

DEFAULT_SIGMA = 0.3
DEFAULT_NET_ARCH = (128, 128)


class CriticFreePolicy(ActorCriticPolicy):
    """Actor of SB3's `ActorCriticPolicy`, without any value network.

    The mean head starts at zero, so an untrained residual policy, run deterministically, leaves the planner as it is.
    Exploration noise is fixed, as in the paper (Eq. 4): the residual's scale is known, so sigma needs no learning.
    With a fixed sigma an entropy bonus would have no effect, hence the algorithm has none.

    Args:
        observation_space: Observation space.
        action_space: Action space; Box, Discrete, MultiDiscrete or MultiBinary.
        lr_schedule: Learning rate as a function of the remaining progress.
        net_arch: Hidden layers of the policy, default [128, 128] (none behind a CNN). A dict keeps only its "pi" entry.
        log_std_init: Logarithm of sigma, default log 0.3 of the action's unit. With gSDE the default is lowered by
            the square root of the latent width, so that latents of unit size give noise of that sigma.
        learn_std: Train sigma together with the mean.
        squash_mean: Keep the mean within the action box by a tanh. The noise is added outside of it, so that what is
            sampled may still leave the box, and is clipped as always; SB3's `squash_output` squashes mean and noise.
        features_extractor_class: As in SB3.
        kwargs: All other arguments of `ActorCriticPolicy`.
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        lr_schedule: Schedule,
        net_arch: list[int] | dict[str, list[int]] | None = None,
        *,
        log_std_init: float | None = None,
        learn_std: bool = False,
        squash_mean: bool = False,
        features_extractor_class: type[BaseFeaturesExtractor] = FlattenExtractor,
        **kwargs: Any,
    ) -> None:
        self.learn_std, self.squash_mean = learn_std, squash_mean
        if squash_mean and not (isinstance(action_space, spaces.Box) and action_space.is_bounded()):
            raise ValueError(f"squash_mean needs a bounded Box of actions; given {action_space}.")
        if squash_mean and kwargs.get("squash_output"):
            raise ValueError("squash_mean and squash_output exclude each other: one of them bounds the mean.")
        layers = _policy_layers(net_arch, features_extractor_class)
        if log_std_init is None:
            log_std_init = math.log(DEFAULT_SIGMA)
            # gSDE's noise is a matrix times the latent vector: its variance grows with the number of latents.
            if kwargs.get("use_sde") and layers:
                log_std_init -= 0.5 * math.log(layers[-1])
        kwargs["share_features_extractor"] = True  # a second extractor would belong to the critic
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            net_arch={"pi": layers, "vf": []},
            log_std_init=log_std_init,
            features_extractor_class=features_extractor_class,
            **kwargs,
        )

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        del self.value_net
        assert isinstance(self.action_net, nn.Linear)
        # A mean of zero: the first rollouts explore around the planner, not around a random correction of it.
        nn.init.zeros_(self.action_net.weight)
        nn.init.zeros_(self.action_net.bias)
        if self.squash_mean:
            assert isinstance(self.action_space, spaces.Box)
            self.action_net = nn.Sequential(self.action_net, WithinBox(self.action_space))
        if hasattr(self, "log_std"):
            self.log_std.requires_grad_(self.learn_std)
        # Built again: SB3's has every parameter, a fixed sigma and the deleted value head among them.
        trained = [parameter for parameter in self.parameters() if parameter.requires_grad]
        self.optimizer = self.optimizer_class(trained, lr=lr_schedule(1), **self.optimizer_kwargs)  # type: ignore[call-arg]

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | {"learn_std": self.learn_std, "squash_mean": self.squash_mean}

    def forward(self, obs: PyTorchObs, deterministic: bool = False) -> tuple[th.Tensor, th.Tensor, th.Tensor]:
        """Return actions, values (zeros: there is no critic) and log-probabilities."""
        distribution = self.get_distribution(obs)
        actions = distribution.get_actions(deterministic=deterministic)
        log_prob = distribution.log_prob(actions)
        values = th.zeros((len(log_prob), 1), device=log_prob.device)
        return actions.reshape((-1, *(self.action_space.shape or ()))), values, log_prob

    def evaluate_actions(self, obs: PyTorchObs, actions: th.Tensor) -> tuple[th.Tensor, th.Tensor, th.Tensor | None]:
        """Return values (zeros), log-probabilities and entropy of the given actions."""
        distribution = self.get_distribution(obs)
        log_prob = distribution.log_prob(actions)
        return th.zeros((len(log_prob), 1), device=log_prob.device), log_prob, distribution.entropy()

    def predict_values(self, obs: PyTorchObs) -> th.Tensor:
        """Return zeros, shape (n, 1): there is no critic."""
        n = len(next(iter(obs.values()))) if isinstance(obs, dict) else len(obs)
        return th.zeros((n, 1), device=self.device)


class CriticFreeCnnPolicy(CriticFreePolicy):
    """Critic-free policy for images."""

    def __init__(self, *args: Any, features_extractor_class: Any = NatureCNN, **kwargs: Any) -> None:
        super().__init__(*args, features_extractor_class=features_extractor_class, **kwargs)


class CriticFreeMultiInputPolicy(CriticFreePolicy):
    """Critic-free policy for Dict observations."""

    def __init__(self, *args: Any, features_extractor_class: Any = CombinedExtractor, **kwargs: Any) -> None:
        super().__init__(*args, features_extractor_class=features_extractor_class, **kwargs)


POLICY_ALIASES: dict[str, type[BasePolicy]] = {
    "MlpPolicy": CriticFreePolicy,
    "CnnPolicy": CriticFreeCnnPolicy,
    "MultiInputPolicy": CriticFreeMultiInputPolicy,
}


def _policy_layers(
    net_arch: list[int] | dict[str, list[int]] | None, extractor: type[BaseFeaturesExtractor]
) -> list[int]:
    if net_arch is None:
        return [] if issubclass(extractor, NatureCNN) else list(DEFAULT_NET_ARCH)
    if isinstance(net_arch, list) and net_arch and isinstance(net_arch[0], dict):
        warnings.warn(
            "net_arch=[dict(...)] is an old form of net_arch=dict(...); its first entry is taken.", stacklevel=4
        )
        net_arch = net_arch[0]
    return list(net_arch.get("pi", [])) if isinstance(net_arch, dict) else list(net_arch)


def renew_noise(policy: ActorCriticPolicy, rows: Any) -> None:
    """Give some env rows a new gSDE exploration matrix; the others keep theirs.

    Rollouts of a group must explore independently, whatever env runs them: each episode needs its own matrix.

    Args:
        policy: A policy with gSDE, after `reset_noise(n_envs)`.
        rows: Integer indices of env rows.
    """
    noise = policy.action_dist
    assert isinstance(noise, StateDependentNoiseDistribution)
    with th.no_grad():
        noise.exploration_matrices[rows] = noise.weights_dist.sample((len(rows),))
    if len(noise.exploration_matrices) == 1:
        noise.exploration_mat = noise.exploration_matrices[0]  # what SB3 reads for a single env
