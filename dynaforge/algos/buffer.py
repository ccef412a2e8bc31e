"""The transitions of an update's episodes, in an order that does not depend on which env ran what."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.type_aliases import PyTorchObs
from stable_baselines3.common.vec_env import VecNormalize

from dynaforge.algos.options import LossAggregation
from dynaforge.geometry import Array, one_line
from dynaforge.sampling.sampler import Job
from dynaforge.sampling.vec_wrappers import Observations, take_rows


@dataclass(frozen=True, kw_only=True)
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
            observations=taken,
            actions=self.actions[index],
            log_probs=self.log_probs[index],
            advantages=self.advantages[index],
            weights=self.weights[index],
        )

    def in_order(self, size: int | None) -> Iterator[KeptTransitions]:
        """Split into parts of this size, of which the last may be smaller; None takes all at once."""
        size = size or max(1, len(self))
        for start in range(0, len(self), size):
            yield self.rows(slice(start, start + size))

    def minibatches(self, parts: int, rng: np.random.Generator) -> Iterator[KeptTransitions]:
        """Shuffle and split into this many parts; a single part stays in order."""
        n = len(self)
        if parts == 1:
            yield self
            return
        shuffled = self.rows(th.as_tensor(rng.permutation(n), device=self.log_probs.device))
        # Sizes differ by one at most: a small remainder, as fixed sizes leave, would be a step of mostly noise.
        edges = np.linspace(0, n, parts + 1).round().astype(int).tolist()
        for start, stop in pairwise(edges):
            yield shuffled.rows(slice(start, stop))


class _Step(NamedTuple):
    """One step of several episodes, a row each: what `add` takes, with the jobs as numbers."""

    observations: Observations
    actions: NDArray[Any]
    log_probs: NDArray[np.float32]
    at_rim: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    groups: NDArray[np.int64]
    rollouts: NDArray[np.int64]


class GroupRolloutBuffer(BaseBuffer):
    """Transitions of the episodes of an update, which may have any lengths.

    The steps of all running episodes are appended together, as they come; `finish` sorts them by group, rollout and
    time. The constructor is that of SB3's `RolloutBuffer`, because the base algorithm calls it so, but discount, lambda
    and `n_envs` play no part: an episode has one return, given at its end and not discounted. `buffer_size` is the
    number of episodes, and no memory is reserved for it.

    Attributes:
        observations: What the policy saw, once finished, shape (n, ...), or a dict of such.
        actions: What it sampled, n rows.
        log_probs: Of those actions, shape (n,).
        at_rim: Whether the mean that an action was sampled around lay at the rim of the action box, shape (n,).
        mask: Whether the action had an effect, shape (n,).
        groups: Index of the transition's group, shape (n,).
        rollouts: Index of its rollout within the group, shape (n,).
    """

    observations: Observations
    actions: NDArray[Any]
    log_probs: NDArray[np.float32]
    at_rim: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    groups: NDArray[np.int64]
    rollouts: NDArray[np.int64]

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
        self._steps: list[_Step] = []

    def add(
        self,
        obs: Observations,
        actions: NDArray[Any],
        log_probs: NDArray[np.float32],
        at_rim: NDArray[np.bool_],
        mask: NDArray[np.bool_],
        jobs: Sequence[Job],
    ) -> None:
        """Append one step of several episodes.

        Args:
            obs: What the policy saw, n rows, array or dict.
            actions: What it sampled, before clipping to the action space, n rows.
            log_probs: Of those actions, shape (n,).
            at_rim: Whether the mean that each was sampled around lay at the rim of the action box, shape (n,).
            mask: Whether the action had an effect ("residual_mask"), shape (n,).
            jobs: Whose step each row is, n jobs.
        """
        groups = np.array([job.group.index for job in jobs])
        rollouts = np.array([job.rollout for job in jobs])
        self._steps.append(_Step(obs, actions, log_probs, at_rim, mask, groups, rollouts))
        self.pos += len(jobs)

    def size(self) -> int:
        """Return the number of transitions."""
        return self.pos

    def finish(self) -> None:
        """Join the steps, sorted by group, rollout and time."""
        if not self._steps:
            raise ValueError("The buffer is empty: no episode was collected.")
        joined = _Step(*(_join(parts) for parts in zip(*self._steps, strict=True)))
        # The sort is stable, so the steps of an episode stay in the order of time.
        order = np.lexsort((joined.rollouts, joined.groups))
        self.observations = take_rows(joined.observations, order)
        self.actions, self.log_probs = joined.actions[order], joined.log_probs[order]
        self.at_rim, self.mask = joined.at_rim[order], joined.mask[order]
        self.groups, self.rollouts = joined.groups[order], joined.rollouts[order]
        self.full = True
        self._steps = []

    def keep(
        self, groups: NDArray[np.bool_], advantages: Array, *, loss_agg: LossAggregation = "step"
    ) -> KeptTransitions:
        """Select the gated transitions of the kept groups, the set I_F of Eq. 9, and move them to the device.

        Args:
            groups: Groups to keep, shape (N,).
            advantages: Of each episode, shape (N, K).
            loss_agg: "step" weighs all transitions alike, "episode" all episodes.
        """
        # Where the gate is closed the action has no effect on the return: its gradient would be noise, and a mean
        # that counted such steps would shrink with the length of the gated-off phases.
        chosen = np.flatnonzero(self.mask & groups[self.groups])
        episode = self.groups[chosen], self.rollouts[chosen]
        weights = np.ones(len(chosen))
        if loss_agg == "episode":
            # Shares that sum to one within each episode, scaled to a mean of 1 over all transitions.
            lengths = np.zeros(advantages.shape, dtype=np.int64)
            np.add.at(lengths, episode, 1)
            weights = len(chosen) / (np.count_nonzero(lengths) * lengths[episode])
        obs = take_rows(self.observations, chosen)
        actions = self._tensor(self.actions[chosen])
        discrete = isinstance(self.action_space, spaces.Discrete)
        return KeptTransitions(
            observations=(
                {key: self._tensor(part) for key, part in obs.items()} if isinstance(obs, dict) else self._tensor(obs)
            ),
            actions=actions.long() if discrete else actions.float().flatten(start_dim=1),
            log_probs=self._tensor(self.log_probs[chosen]),
            # Every transition of an episode has the episode's advantage: Eq. 6 pays one return, at its end.
            advantages=self._tensor(advantages[episode]),
            weights=self._tensor(weights),
        )

    def _tensor(self, array: NDArray[Any]) -> th.Tensor:
        wide = array.dtype == np.float64
        return th.as_tensor(array.astype(np.float32) if wide else array, device=self.device)

    def _get_samples(self, batch_inds: NDArray[np.int64], env: VecNormalize | None = None) -> Any:
        raise NotImplementedError("Episodes are read with `keep(...).minibatches(...)`.")


def _join(parts: Sequence[Any]) -> Any:
    """Concatenate arrays, or dicts of arrays key by key."""
    if isinstance(parts[0], dict):
        return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    return np.concatenate(parts)
