"""Residual policies as files that run no code: weights in safetensors, everything else in their JSON header."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dynaforge.files.atomic import atomic_write
from dynaforge.registration import ENV_NAMES, env_id, task_named

if TYPE_CHECKING:  # workers that only run a policy do without torch, which takes seconds to import
    from stable_baselines3.common.base_class import BaseAlgorithm

FORMAT = "dynaforge-policy"

POLICY_FILE = "policy.safetensors"
"""Name of the file in the folder of a training, and beside the assets of a task."""

_ACTIVATIONS: dict[str, Callable[[Any], Any]] = {"Tanh": np.tanh, "ReLU": lambda x: np.maximum(x, 0.0)}


class Named(Protocol):
    """A task, of which a policy file needs no more than the name."""

    @property
    def name(self) -> str:
        """Return the task's name, under which its envs are registered."""


Layers = Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]


class MlpPolicyFile:
    """The deterministic part of a trained policy: mean of Eq. 4, in plain numpy (9 us per call).

    `load` and `of` check what they return: finite weights, layers that chain, sizes that fit the task.

    Attributes:
        activation: Name of the activation between layers.
        squash_mean: Whether a tanh bounds what the last layer gives, in place of clipping.
        task: Name of the task it was trained on.
        meta: Plain JSON data kept with it: digest and setting of the task it is for, how it was trained, versions.
        digest: SHA-256 over task and weights: names the policy in every episode it makes.
    """

    def __init__(
        self,
        layers: list[tuple[NDArray[np.float32], NDArray[np.float32]]],
        activation: str,
        *,
        task: str,
        meta: Mapping[str, Any] | None = None,
        squash_mean: bool = False,
    ) -> None:
        if activation not in _ACTIVATIONS:
            raise ValueError(f"Activation {activation!r} is not supported; known are {', '.join(_ACTIVATIONS)}.")
        self._layers = layers
        self.activation, self.squash_mean = activation, squash_mean
        self.task = task
        self.meta = dict(meta or {})

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the residual action in [-1, 1], shape (d,), for one observation."""
        x, nonlinearity = observation, _ACTIVATIONS[self.activation]
        for weight, bias in self._layers[:-1]:
            x = nonlinearity(weight @ x + bias)
        weight, bias = self._layers[-1]
        mean = weight @ x + bias
        return np.asarray(np.tanh(mean)) if self.squash_mean else np.clip(mean, -1.0, 1.0)

    @property
    def digest(self) -> str:
        """Name of the policy: equal policies have equal digests."""
        digest = hashlib.sha256(f"{self.task} {self.activation}{' squashed' * self.squash_mean}".encode())
        for weight, bias in self._layers:
            digest.update(weight.tobytes() + bias.tobytes())
        return digest.hexdigest()[:16]

    @staticmethod
    def of(model: BaseAlgorithm, *, task: str | Named, meta: Mapping[str, Any] | None = None) -> MlpPolicyFile:
        """Take the policy out of a trained model with "MlpPolicy": FrontierGRPO, ResidualSAC or SB3's on-policy ones.

        What stood between model and env is read off its env: one that `PPO.load` read without its env must have been
        trained without VecNormalize.

        Args:
            model: The trained model.
            task: The task that it was trained on: a task, its name, or an env id of it. A name stands for the task as
                it is registered, so pass the task itself if it was trained under another setting.
            meta: Plain JSON data to keep with it; the digest of the task and its setting are added.

        Raises:
            ValueError: Unknown task, sizes that do not fit it, or a policy of which the file would not hold all:
                anything but a plain MLP from a flat observation to an action in [-1, 1].
        """
        from dynaforge.algos.plain_mlp import plain_mlp, squashes_mean

        name = _name_of(task)
        layers, activation = plain_mlp(model)
        if fault := _fault_of(layers) or _misfit(layers, name):
            raise ValueError(f"The policy cannot be written as a policy file: {fault}.")
        env_class, arguments = _env_of(name)
        definition = env_class.definition(**arguments | ({} if isinstance(task, str) else {"task": task}))
        kept = {**(meta or {}), **definition}
        return MlpPolicyFile(layers, activation, task=name, meta=kept, squash_mean=squashes_mean(model))

    def save(self, path: str | Path) -> None:
        """Write the policy, replacing the file as a whole or not at all."""
        header: dict[str, Any] = {"format": FORMAT, "task": self.task, "activation": self.activation, "meta": self.meta}
        if self.squash_mean:  # left out otherwise, as in the files of before
            header["squash_mean"] = True
        tensors: dict[str, NDArray[np.float32]] = {}
        for k, (weight, bias) in enumerate(self._layers):
            tensors |= {f"{k}.weight": weight, f"{k}.bias": bias}
        atomic_write(Path(path), save(tensors, {"dynaforge": json.dumps(header, sort_keys=True)}))

    @staticmethod
    def load(path: str | Path, *, task: str | Named | None = None) -> MlpPolicyFile:
        """Read a policy; runs no code from the file.

        Whether it was trained for the task as it is now is not checked here, but by `make_generator`.

        Args:
            path: The file.
            task: What it shall be for: a task, its name, or an env id of it. None takes the task that the file names.

        Raises:
            FileNotFoundError: No such file.
            ValueError: Not a policy file, a damaged one, or one of another task, or whose sizes do not fit the task.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(f"No policy file {path}. `dynaforge forge` and `dynaforge train` write them.")
        asked = None if task is None else _name_of(task)
        try:
            policy = _read(path)
        except (SafetensorError, KeyError, ValueError, TypeError, RecursionError) as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{path} is no dynaforge policy file, or is damaged: {reason.rstrip('.')}.") from error
        if asked is not None and policy.task != asked:
            raise ValueError(f"{path} is a policy for task {policy.task!r}, not for {asked!r}.")
        if asked is None and policy.task not in ENV_NAMES:
            raise ValueError(
                f"{path} is a policy for task {policy.task!r}, which is none of {', '.join(ENV_NAMES)}. If it is one "
                "of your own, pass it as `task`: `get_task` reads its file."
            )
        if fault := _misfit(policy._layers, policy.task):
            raise ValueError(f"{path} does not fit: {fault}.")
        return policy


def _read(path: str | Path) -> MlpPolicyFile:
    with safe_open(str(path), framework="numpy") as file:
        metadata = file.metadata() or {}
        if "dynaforge" not in metadata:
            raise ValueError("it has no dynaforge header")
        header = json.loads(metadata["dynaforge"])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no iterator of its own
    if not isinstance(header, dict):
        raise ValueError(f"its header is {type(header).__name__}, expected a mapping")
    if header.get("format") != FORMAT:
        raise ValueError(f"its format is {header.get('format')!r}, expected {FORMAT!r}")
    for name, kind in (("task", str), ("activation", str), ("meta", dict)):
        if not isinstance(header.get(name), kind):
            raise ValueError(f"{name} in its header is {header.get(name)!r:.80}, expected {kind.__name__}")
    names = [f"{k}.{part}" for k in range(len(tensors) // 2) for part in ("weight", "bias")]
    if not names or set(names) != set(tensors):
        raise ValueError(f"its tensors are {sorted(tensors)!s:.80}, expected a weight and a bias of every layer")
    layers = [(tensors[weight], tensors[bias]) for weight, bias in zip(names[::2], names[1::2], strict=True)]
    if fault := _fault_of(layers):
        raise ValueError(fault)
    squash = header.get("squash_mean", False)
    if not isinstance(squash, bool):
        raise ValueError(f"squash_mean in its header is {squash!r:.80}, expected true or false")
    return MlpPolicyFile(layers, header["activation"], task=header["task"], meta=header["meta"], squash_mean=squash)


def _fault_of(layers: Layers) -> str:
    """Say what is wrong with the layers of an MLP: their types, shapes and values; "" if nothing is."""
    width: int | None = None
    for k, (weight, bias) in enumerate(layers):
        if weight.dtype != np.float32 or bias.dtype != np.float32:
            return f"layer {k} holds {weight.dtype} and {bias.dtype}, expected float32"
        if weight.ndim != 2 or bias.shape != weight.shape[:1] or not weight.size:
            return f"layer {k} has a weight of shape {weight.shape} and a bias of shape {bias.shape}"
        if width not in (None, weight.shape[1]):
            return f"layer {k} takes {weight.shape[1]} numbers, and the layer before gives {width}"
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            return f"layer {k} holds NaN or infinity"
        width = len(bias)
    return ""


def _name_of(task: str | Named) -> str:
    if not isinstance(task, str):
        return task.name
    name = task_named(task)
    if name is None:
        hint = f"pass get_task({task!r})" if task.endswith(".py") else f"known are {', '.join(ENV_NAMES)}"
        raise ValueError(f"No task {task!r} is registered; {hint}.")
    return name


def _misfit(layers: Layers, task: str) -> str:
    """Say how the sizes of a policy differ from those of a task's residual env; "" if they do not."""
    env_class, arguments = _env_of(task)
    sizes, expected = (layers[0][0].shape[1], len(layers[-1][1])), env_class.sizes(**arguments)
    if sizes == expected:
        return ""
    return (
        f"it takes {sizes[0]} numbers and gives {sizes[1]}, but an observation of task {task!r} has "
        f"{expected[0]} and its action {expected[1]}"
    )


def _env_of(task: str) -> tuple[Any, dict[str, Any]]:
    """Return the class of a task's residual env, found where Gymnasium finds it, and its arguments; makes no env."""
    spec = gym.spec(env_id(task))
    return load_env_creator(str(spec.entry_point)), dict(spec.kwargs)
