"""What a resumed run must take over so that it goes on as if it had never stopped."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th


@dataclass(frozen=True)
class RandomState:
    """States of the sources of randomness, and the step count, at one moment.

    Attributes:
        generators: Bit generator states, in the order given.
        torch: State of torch's CPU generator and, on CUDA, of the device's.
        num_timesteps: Steps counted so far.
    """

    generators: tuple[Any, ...]
    torch: tuple[th.Tensor, ...]
    num_timesteps: int

    @staticmethod
    def of(generators: tuple[np.random.Generator, ...], device: th.device, num_timesteps: int) -> RandomState:
        """Take a copy of the present state."""
        states = tuple(deepcopy(generator.bit_generator.state) for generator in generators)
        cuda = (th.cuda.get_rng_state(device),) if device.type == "cuda" else ()
        return RandomState(states, (th.get_rng_state(), *cuda), num_timesteps)

    def restore_generators(self, generators: tuple[np.random.Generator, ...]) -> None:
        """Set numpy generators back to this state."""
        for generator, state in zip(generators, self.generators, strict=True):
            generator.bit_generator.state = state

    def restore_torch(self, device: th.device) -> None:
        """Set torch's generators back to this state, the one of `device` if it and the one read from are CUDA's."""
        th.set_rng_state(self.torch[0].cpu())
        if len(self.torch) > 1 and device.type == "cuda":
            th.cuda.set_rng_state(self.torch[1].cpu(), device)
