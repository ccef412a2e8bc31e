"""Means at the rim of the action box, where the env clips them and no return tells how far beyond they are."""

from __future__ import annotations

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.distributions import (
    DiagGaussianDistribution,
    Distribution,
    StateDependentNoiseDistribution,
)
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

RIM = 0.99  # of the way from the centre of the box to its bound


def has_rim(policy: ActorCriticPolicy) -> bool:
    """Return whether a policy's actions are Gaussian in a bounded box, so that their means may lie at its rim."""
    space = policy.action_space
    bounded = isinstance(space, spaces.Box) and space.is_bounded()
    return bounded and not policy.squash_output


def reach(distribution: Distribution, space: spaces.Space) -> th.Tensor:
    """Return how far each component of the means lies from the centre of the box, 1 at its bounds, shape (n, d).

    Args:
        distribution: Of a policy that `has_rim`.
        space: Its action space, a bounded Box.
    """
    assert isinstance(distribution, (DiagGaussianDistribution, StateDependentNoiseDistribution))
    assert isinstance(space, spaces.Box)
    mean = distribution.distribution.mean
    centre, half = (th.as_tensor(side.flatten(), device=mean.device) for side in centre_and_half(space))
    return ((mean - centre) / half).abs()


def centre_and_half(space: spaces.Box) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of a box and half its size, of its shape, as float32."""
    low, high = space.low.astype(np.float32), space.high.astype(np.float32)
    return (high + low) / 2, (high - low) / 2


def rim_penalty(distribution: Distribution, space: spaces.Space) -> th.Tensor:
    """Return by how much the means lie outside the box, squared and summed over components, shape (n,); 0 inside.

    The env clips what is outside, so that every action there has the same return. Nothing then draws a mean back, and
    one that was pushed out stays where half of its noise, or all of it, has no effect.

    Args:
        distribution: Of a policy that `has_rim`.
        space: Its action space, a bounded Box.
    """
    return ((reach(distribution, space) - 1.0).clamp(min=0.0) ** 2).sum(dim=1)


@th.no_grad()
def means_at_rim(policy: ActorCriticPolicy) -> th.Tensor:
    """Return for which rows some component of the mean is at the rim or beyond, shape (n,).

    Args:
        policy: A policy that `has_rim`, and has just sampled actions: the rows are theirs.
    """
    return (reach(policy.action_dist, policy.action_space) >= RIM).any(dim=1)


class WithinBox(nn.Module):
    """Squashes means into the action box: centre + half * tanh(x), which is x near the centre of [-1, 1].

    Args:
        space: The box, bounded.
    """

    centre: th.Tensor
    half_size: th.Tensor

    def __init__(self, space: spaces.Box) -> None:
        super().__init__()
        centre, half = (th.as_tensor(side.flatten()) for side in centre_and_half(space))
        self.register_buffer("centre", centre, persistent=False)
        self.register_buffer("half_size", half, persistent=False)

    def forward(self, x: th.Tensor) -> th.Tensor:
        """Return the means, shape (n, d)."""
        return self.centre + self.half_size * th.tanh(x)
