"""Whole episodes of an update, in an order that no scheduling of envs can change."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.type_aliases import PyTorchObs
from stable_baselines3.common.vec_env import VecNormalize

from dynaforge.geometry import Array, one_line


@dataclass(frozen=True)
class KeptTransitions:
    """The transitions that enter the loss (the set I_F of Eq. 9), as tensors.

    Attributes:
        observations: Shape (n, ...), or a dict of such.
        actions: Shape (n, d), or (n,) for Discrete.
        log_probs: Under the policy that acted, shape (n,).
        advantages: Of the transition's episode, shape (n,).
        weights: Share of each transition in the mean, shape (n,), mean 1.
    """

    observations: PyTorchObs
    actions: th.Tensor
    log_probs: th.Tensor
    advantages: th.Tensor
    weights: th.Tensor

    __repr__ = one_line

    def __len__(self) -> int:
        return len(self.log_probs)

    def rows(self, index: Any) -> KeptTransitions:
        """Return some of the transitions; a slice shares their memory."""
        obs = self.observations
        taken = {key: part[index] for key, part in obs.items()} if isinstance(obs, dict) else obs[index]
        return KeptTransitions(
            taken, self.actions[index], self.log_probs[index], self.advantages[index], self.weights[index]
        )

    def minibatches(self, parts: int, rng: np.random.Generator) -> Iterator[KeptTransitions]:
        """Shuffle and split into so many equal parts; a single part stays in order.

        Equal parts (sizes differ by one at most) leave no tiny rest whose step would be mostly noise.
        """
        n = len(self)
        if parts == 1:
            yield self
            return
        shuffled = self.rows(th.as_tensor(rng.permutation(n), device=self.log_probs.device))
        edges = np.linspace(0, n, parts + 1).round().astype(int).tolist()
        for start, stop in pairwise(edges):
            yield shuffled.rows(slice(start, stop))


class GroupRolloutBuffer(BaseBuffer):
    """Transitions of N*K episodes of any lengths.

    Steps of all running episodes are appended together, as they come; `finish` puts them in order of job and time.
    The constructor is that of SB3's `RolloutBuffer`, since the base algorithm builds it so; discount, lambda and
    `n_envs` play no part. `buffer_size` counts episodes and reserves nothing.
    """

    observations: NDArray[Any] | dict[str, NDArray[Any]]
    actions: NDArray[Any]
    log_probs: NDArray[np.float32]
    mask: NDArray[np.bool_]
    jobs: NDArray[np.int64]

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        device: th.device | str = "auto",
        gae_lambda: float = 1.0,
        gamma: float = 1.0,
        n_envs: int = 1,
    ) -> None:
        super().__init__(buffer_size, observation_space, action_space, device, n_envs=n_envs)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        super().reset()
        self._steps: list[tuple[Any, NDArray[Any], NDArray[np.float32], NDArray[np.bool_], NDArray[np.int64]]] = []

    def add(self, obs: Any, actions: NDArray[Any], log_probs: Any, mask: NDArray[np.bool_], jobs: Any) -> None:
        """Append one step of several episodes.

        Args:
            obs: What the policy saw, n rows, array or dict.
            actions: What it sampled, before clipping to the action space, n rows.
            log_probs: Of those actions, shape (n,).
            mask: Whether the action had an effect ("residual_mask"), shape (n,).
            jobs: Index of each row's job, shape (n,).
        """
        self._steps.append((obs, actions, log_probs, mask, jobs))
        self.pos += len(jobs)

    def size(self) -> int:
        """Return the number of transitions."""
        return self.pos

    def finish(self) -> None:
        """Join the steps, sorted by job and, within a job, by time."""
        if not self._steps:
            raise ValueError("The buffer is empty: no episode was collected.")
        obs, actions, log_probs, mask, jobs = zip(*self._steps, strict=True)
        joined = np.concatenate(jobs)
        order = np.argsort(joined, kind="stable")
        if isinstance(obs[0], dict):
            self.observations = {key: np.concatenate([step[key] for step in obs])[order] for key in obs[0]}
        else:
            self.observations = np.concatenate(obs)[order]
        self.actions = np.concatenate(actions)[order]
        self.log_probs = np.concatenate(log_probs)[order]
        self.mask = np.concatenate(mask)[order]
        self.jobs = joined[order]
        self.full = True
        self._steps = []

    def keep(self, groups: NDArray[np.bool_], advantages: Array, *, loss_agg: str = "step") -> KeptTransitions:
        """Select the gated transitions of the kept groups and move them to the device, once an update.

        Args:
            groups: Groups to keep, shape (N,).
            advantages: Of each episode, shape (N, K).
            loss_agg: "step" weighs all transitions alike, "episode" all episodes.
        """
        group_size = advantages.shape[1]
        chosen = np.flatnonzero(self.mask & groups[self.jobs // group_size])
        jobs = self.jobs[chosen]
        weights = np.ones(len(jobs))
        if loss_agg == "episode" and len(jobs):
            lengths = np.bincount(jobs, minlength=advantages.size)
            weights = len(jobs) / (np.count_nonzero(lengths) * lengths[jobs])
        obs = self.observations
        taken = {k: self._tensor(v[chosen]) for k, v in obs.items()} if isinstance(obs, dict) else obs[chosen]
        actions = self._tensor(self.actions[chosen])
        discrete = isinstance(self.action_space, spaces.Discrete)
        return KeptTransitions(
            observations=taken if isinstance(taken, dict) else self._tensor(taken),
            actions=actions.long() if discrete else actions.float().flatten(start_dim=1),
            log_probs=self._tensor(self.log_probs[chosen]),
            advantages=self._tensor(advantages.reshape(-1)[jobs]),
            weights=self._tensor(weights),
        )

    def _tensor(self, array: NDArray[Any]) -> th.Tensor:
        wide = array.dtype == np.float64
        return th.as_tensor(array.astype(np.float32) if wide else array, device=self.device)

    def _get_samples(self, batch_inds: NDArray[np.int64], env: VecNormalize | None = None) -> Any:
        raise NotImplementedError("Episodes are read with `keep(...).minibatches(...)`.")
