"""The randomness of a training run: what a resumed run needs to continue as if it had never stopped."""

from __future__ import annotations

import warnings
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch as th
from stable_baselines3.common.vec_env import VecNormalize

from dynaforge.geometry import one_line


class RandomModel(Protocol):
    """What a `RandomState` reads and sets of a FrontierGRPO model."""

    condition_rng: np.random.Generator
    minibatch_rng: np.random.Generator
    device: th.device
    num_timesteps: int

    def get_vec_normalize_env(self) -> VecNormalize | None:
        """Return the VecNormalize around the env, if there is one."""


@dataclass(frozen=True)
class RandomState:
    """States of a model's sources of randomness, its step count and VecNormalize's statistics, at one moment.

    Attributes:
        generators: Bit generator states of `condition_rng` and `minibatch_rng`.
        torch: State of torch's CPU generator and, on CUDA, of the device's.
        num_timesteps: Steps counted so far.
        normalisation: Statistics of observations (VecNormalize's `obs_rms`); None without VecNormalize.
    """

    generators: tuple[Any, ...]
    torch: tuple[th.Tensor, ...]
    num_timesteps: int
    normalisation: Any = None

    __repr__ = one_line

    @staticmethod
    def of(model: RandomModel) -> RandomState:
        """Take a copy of a model's present state."""
        generators = tuple(deepcopy(rng.bit_generator.state) for rng in (model.condition_rng, model.minibatch_rng))
        cuda = (th.cuda.get_rng_state(model.device),) if model.device.type == "cuda" else ()
        normalised = model.get_vec_normalize_env()
        statistics = deepcopy(normalised.obs_rms) if normalised is not None and normalised.norm_obs else None
        return RandomState(generators, (th.get_rng_state(), *cuda), model.num_timesteps, statistics)

    def restore_generators(self, model: RandomModel) -> None:
        """Set a model's generators and its step count back to this state."""
        for rng, state in zip((model.condition_rng, model.minibatch_rng), self.generators, strict=True):
            rng.bit_generator.state = state
        model.num_timesteps = self.num_timesteps

    def restore_normalisation(self, normalised: VecNormalize | None) -> None:
        """Give VecNormalize the statistics that the policy has learned with; warn if the env is without it."""
        if self.normalisation is None:
            return
        if normalised is None or not normalised.norm_obs:
            warnings.warn(
                "This model has learned behind VecNormalize, and its env has none, so that it would see other numbers. "
                "Wrap the env in VecNormalize(env, norm_reward=False); the statistics are in the model.",
                stacklevel=6,
            )
            return
        normalised.obs_rms = deepcopy(self.normalisation)

    def restore_torch(self, device: th.device) -> None:
        """Set torch's generators back to this state, the one of `device` if it and the one read from are CUDA's."""
        th.set_rng_state(self.torch[0].cpu())
        if len(self.torch) > 1 and device.type == "cuda":
            th.cuda.set_rng_state(self.torch[1].cpu(), device)
