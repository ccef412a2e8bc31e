"""Residual policies as files that run no code: weights in safetensors, everything else in their JSON header."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dynaforge.demos import atomic_write

if TYPE_CHECKING:  # workers that only run a policy do without torch, which takes seconds to import
    import torch as th
    from stable_baselines3.common.base_class import BaseAlgorithm

FORMAT = "dynaforge-policy"
_ACTIVATIONS: dict[str, Callable[[Any], Any]] = {"Tanh": np.tanh, "ReLU": lambda x: np.maximum(x, 0.0)}


class MlpPolicyFile:
    """The deterministic part of a trained policy: mean of Eq. 4, in plain numpy (9 us a call).

    Attributes:
        task: The task it was trained on.
        meta: Plain JSON data kept with it: how it was trained, versions.
        digest: SHA-256 over task and weights: names the policy in every episode it makes.
    """

    def __init__(
        self, layers: list[tuple[NDArray[np.float32], NDArray[np.float32]]], activation: str, *, task: str,
        meta: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        if activation not in _ACTIVATIONS:
            raise ValueError(f"Activation {activation!r} is not supported; known are {', '.join(_ACTIVATIONS)}.")
        self._layers = layers
        self.activation = activation
        self.task = task
        self.meta = dict(meta or {})

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the residual action in [-1, 1], shape (d,), for one observation."""
        x, nonlinearity = observation, _ACTIVATIONS[self.activation]
        for weight, bias in self._layers[:-1]:
            x = nonlinearity(weight @ x + bias)
        weight, bias = self._layers[-1]
        return np.clip(weight @ x + bias, -1.0, 1.0)

    @property
    def digest(self) -> str:
        """Name of the policy: equal policies have equal digests."""
        digest = hashlib.sha256(f"{self.task} {self.activation}".encode())
        for weight, bias in self._layers:
            digest.update(weight.tobytes() + bias.tobytes())
        return digest.hexdigest()[:16]

    @staticmethod
    def of(model: BaseAlgorithm, *, task: str, meta: Mapping[str, Any] | None = None) -> MlpPolicyFile:
        """Take the policy out of a trained SB3 on-policy model with "MlpPolicy".

        Raises:
            ValueError: Its policy is not a plain MLP.
        """
        from stable_baselines3.common.policies import ActorCriticPolicy
        from torch.nn import Linear

        policy: Any = model.policy
        if not isinstance(policy, ActorCriticPolicy):
            raise ValueError(f"Only an MLP policy can be written as a policy file, not {type(policy).__name__}.")
        net = [*policy.mlp_extractor.policy_net, policy.action_net]
        linear = [m for m in net if isinstance(m, Linear)]
        names = {type(m).__name__ for m in net if not isinstance(m, Linear)}
        if len(names) > 1 or type(policy.features_extractor).__name__ != "FlattenExtractor":
            raise ValueError("Only a plain MLP policy can be written as a policy file.")
        layers = [(_array(m.weight), _array(m.bias)) for m in linear]
        return MlpPolicyFile(layers, names.pop() if names else "Tanh", task=task, meta=meta)

    def save(self, path: str | Path) -> None:
        """Write the policy, replacing the file as a whole or not at all."""
        header = {"format": FORMAT, "task": self.task, "activation": self.activation, "meta": self.meta}
        tensors: dict[str, NDArray[np.float32]] = {}
        for k, (weight, bias) in enumerate(self._layers):
            tensors |= {f"{k}.weight": weight, f"{k}.bias": bias}
        atomic_write(Path(path), save(tensors, {"dynaforge": json.dumps(header, sort_keys=True)}))

    @staticmethod
    def load(path: str | Path, *, task: str | None = None) -> MlpPolicyFile:
        """Read a policy; runs no code from the file.

        Raises:
            FileNotFoundError: No such file.
            ValueError: Not a policy file, a damaged one, or one of another task than `task`.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(f"No policy file {path}. `dynaforge forge` and `dynaforge train` write them.")
        try:
            with safe_open(str(path), framework="numpy") as file:
                header = json.loads((file.metadata() or {})["dynaforge"])
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no iterator of its own
            layers = [(tensors[f"{k}.weight"], tensors[f"{k}.bias"]) for k in range(len(tensors) // 2)]
            policy = MlpPolicyFile(layers, header["activation"], task=header["task"], meta=header["meta"])
        except (SafetensorError, KeyError, ValueError) as error:
            raise ValueError(f"{path} is no dynaforge policy file, or is damaged: {error}.") from error
        if task is not None and policy.task != task:
            raise ValueError(f"{path} is a policy for task {policy.task!r}, not for {task!r}.")
        return policy


def _array(parameter: th.Tensor) -> NDArray[np.float32]:
    return parameter.detach().cpu().numpy().astype(np.float32)
