"""What a policy file can hold of a Stable-Baselines3 model: the layers of a plain MLP, and nothing else of effect."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.torch_layers import FlattenExtractor
from torch import nn

from dynaforge.algos.policies import CriticFreePolicy
from dynaforge.algos.residual_sac import ResidualSACPolicy

Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


def plain_mlp(model: BaseAlgorithm) -> tuple[Layers, str]:
    """Return the layers and the name of the activation of a model whose deterministic policy is a plain MLP.

    Raises:
        ValueError: Something else acts on its observations or actions; names it.
    """
    policy = model.policy
    if type(policy) not in (ActorCriticPolicy, CriticFreePolicy, ResidualSACPolicy):
        raise ValueError(f"Only an MLP policy can be written as a policy file, not {type(policy).__name__}.")
    assert isinstance(policy, (ActorCriticPolicy, ResidualSACPolicy))
    if reason := _beyond_a_plain_mlp(model, policy):
        raise ValueError(f"Only a plain MLP policy can be written as a policy file; {reason}.")
    hidden = _hidden(policy)
    linear = [module for module in [*hidden, _last_linear(policy)] if isinstance(module, nn.Linear)]
    layers = [(_array(module.weight), _array(module.bias)) for module in linear]
    kinds = {type(module).__name__ for module in hidden if not isinstance(module, nn.Linear)}
    return layers, kinds.pop() if kinds else "Tanh"


def _beyond_a_plain_mlp(model: BaseAlgorithm, policy: ActorCriticPolicy | ResidualSACPolicy) -> str:
    """Describe what a plain MLP would leave out of the model; "" if nothing."""
    observation, action = policy.observation_space, policy.action_space
    normalised, loaded = model.get_vec_normalize_env(), getattr(model, "_saved_state", None)
    carried = loaded is not None and loaded.normalisation is not None
    if carried or (normalised is not None and normalised.norm_obs):
        return (
            "this one sees observations through VecNormalize: train without `normalize`, the env's are scaled already"
        )
    if wrapper := _changing_wrapper(model):
        return f"this one's env stands in a {wrapper}, which the file would leave out: train without it"
    if policy.squash_output and not isinstance(policy, ResidualSACPolicy):
        return "this one squashes its output: train without `squash_output`"
    extractor = type(getattr(policy, "actor", policy).features_extractor)
    if extractor is not FlattenExtractor:
        return f"this one has the features extractor {extractor.__name__}"
    if not isinstance(observation, spaces.Box) or len(observation.shape) != 1 or is_image_space(observation):
        return f"this one observes {observation}, which is no flat vector"
    if not isinstance(action, spaces.Box) or len(action.shape) != 1:
        return f"this one acts in {action}, which is no flat Box"
    if not ((action.low == -1.0).all() and (action.high == 1.0).all()):
        return f"this one acts in {action}, and a policy file gives actions in [-1, 1]"
    hidden = _hidden(policy)
    kinds = {type(module) for module in hidden[1::2]}
    shape = [isinstance(module, nn.Linear) for module in hidden]
    if shape != [k % 2 == 0 for k in range(len(hidden))] or len(kinds) > 1:
        return f"this one's layers are {', '.join(type(module).__name__ for module in hidden)}"
    if not isinstance(_last_linear(policy), nn.Linear):
        return f"this one's last layer is {type(_last_linear(policy)).__name__}"
    if not kinds <= {nn.Tanh, nn.ReLU}:
        return f"this one's activation is {kinds.pop().__name__}; Tanh and ReLU are supported"
    return ""


def squashes_mean(model: BaseAlgorithm) -> bool:
    """Return whether a model's policy bounds its mean by a tanh, the one thing besides layers that a file can hold."""
    policy = model.policy
    return isinstance(policy, ResidualSACPolicy) or (isinstance(policy, CriticFreePolicy) and policy.squash_mean)


def _hidden(policy: ActorCriticPolicy | ResidualSACPolicy) -> list[nn.Module]:
    return list(policy.actor.latent_pi if isinstance(policy, ResidualSACPolicy) else policy.mlp_extractor.policy_net)


def _last_linear(policy: ActorCriticPolicy | ResidualSACPolicy) -> nn.Module:
    if isinstance(policy, ResidualSACPolicy):
        return policy.actor.mu
    squashed = isinstance(policy, CriticFreePolicy) and policy.squash_mean
    return policy.action_net[0] if squashed else policy.action_net  # type: ignore[index]


def _changing_wrapper(model: BaseAlgorithm) -> str:
    """Name the kind of Gymnasium wrapper that changes what the policy sees or does; "" if there is none to be seen."""
    env = model.get_env()
    try:
        kinds = [kind for kind in (gym.ObservationWrapper, gym.ActionWrapper) if env and any(env.env_is_wrapped(kind))]
    except (OSError, EOFError, RuntimeError):  # its workers have ended
        return ""
    return f"gymnasium.{kinds[0].__name__}" if kinds else ""


def _array(parameter: th.Tensor) -> NDArray[np.float32]:
    return parameter.detach().cpu().numpy().astype(np.float32)
