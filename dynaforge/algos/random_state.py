"""What a resumed run must take over so that it goes on as if it had never stopped."""

from __future__ import annotations

import warnings
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.vec_env import VecNormalize

from dynaforge.geometry import one_line


@dataclass(frozen=True)
class RandomState:
    """States of the sources of randomness, the step count and VecNormalize's statistics, at one moment.

    Attributes:
        generators: Bit generator states, in the order given.
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
    def of(
        generators: tuple[np.random.Generator, ...], device: th.device, num_timesteps: int,
        normalised: VecNormalize | None = None,
    ) -> RandomState:  # fmt: skip
        """Take a copy of the present state."""
        states = tuple(deepcopy(generator.bit_generator.state) for generator in generators)
        cuda = (th.cuda.get_rng_state(device),) if device.type == "cuda" else ()
        statistics = deepcopy(normalised.obs_rms) if normalised is not None and normalised.norm_obs else None
        return RandomState(states, (th.get_rng_state(), *cuda), num_timesteps, statistics)

    def restore_normalisation(self, normalised: VecNormalize | None) -> None:
        """Give VecNormalize the statistics that the policy has learned with; without it, warn of what is missing."""
        if self.normalisation is None:
            return
        if normalised is None or not normalised.norm_obs:
            warnings.warn(
                "This model has learned behind VecNormalize, and its env has none: it does not go on as it was. Wrap "
                "the env in VecNormalize(env, norm_reward=False); the statistics are in the model.",
                stacklevel=4,
            )
            return
        normalised.obs_rms = deepcopy(self.normalisation)

    def restore_generators(self, generators: tuple[np.random.Generator, ...]) -> None:
        """Set numpy generators back to this state."""
        for generator, state in zip(generators, self.generators, strict=True):
            generator.bit_generator.state = state

    def restore_torch(self, device: th.device) -> None:
        """Set torch's generators back to this state, the one of `device` if it and the one read from are CUDA's."""
        th.set_rng_state(self.torch[0].cpu())
        if len(self.torch) > 1 and device.type == "cuda":
            th.cuda.set_rng_state(self.torch[1].cpu(), device)
