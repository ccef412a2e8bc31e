"""The replay buffers of residual SAC: what was decided in training, and where the planner alone succeeded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

from dynaforge.geometry import Array, one_line

ROWS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Decision:
    """One decision of one env, and what it led to.

    Attributes:
        observation: What was observed when it was due.
        next_observation: What was observed at the next decision, or at the end of the episode.
        action: The action, within [-1, 1].
        reward: Sum of the rewards up to there.
        done: Whether the episode ended.
        info: Of the last step.
    """

    observation: Array
    next_observation: Array
    action: Array
    reward: float
    done: bool
    info: dict[str, Any]

    __repr__ = one_line


class DecisionReplay(ReplayBuffer):
    """A replay buffer of decisions, with a second one for the successes of the planner; batches take half from each.

    An episode enters whole when it ends: into `planner` if it succeeded and every residual in it was zero, else into
    this buffer. Steps with `info["residual_mask"]` 0 carry no decision: they prolong the decision before them, and
    those before the first one are left out. So both gate modes of a `ResidualEnv` fill the buffers with the same.

    Args:
        buffer_size: Decisions that each buffer holds.
        observation_space: Observation space, a Box.
        action_space: Action space.
        device: Where batches go.
        n_envs: Number of envs that episodes come from.
        optimize_memory_usage: Has no effect.
        seed: Seeds the draws of batches.

    Attributes:
        planner: The second buffer.
        rng: Draws the batches.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        device: th.device | str = "auto",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        *,
        seed: int | None = None,
    ) -> None:
        super().__init__(buffer_size, observation_space, action_space, device)
        self.planner = ReplayBuffer(buffer_size, observation_space, action_space, device)
        self.rng = np.random.default_rng(seed)
        self._episodes: list[list[Decision]] = [[] for _ in range(n_envs)]

    def add(
        self, obs: Array, next_obs: Array, action: Array, reward: Array, done: NDArray[np.bool_], infos: list[Any]
    ) -> None:
        """Add a step of all envs; as in SB3, `next_obs` holds the last observation of an episode that ended."""
        for k, info in enumerate(infos):
            episode = self._episodes[k]
            outcome = {
                "next_observation": np.array(next_obs[k]),
                "reward": float(reward[k]),
                "done": bool(done[k]),
                "info": info,
            }
            if info.get("residual_mask", 1.0):
                episode.append(Decision(observation=np.array(obs[k]), action=np.array(action[k]), **outcome))
            elif episode:
                outcome["reward"] += episode[-1].reward
                episode[-1] = replace(episode[-1], **outcome)
            if done[k]:
                self._store(episode, success=bool(info.get("is_success")))
                episode.clear()

    def _store(self, episode: list[Decision], *, success: bool) -> None:
        by_planner = success and not any(decision.action.any() for decision in episode)
        for d in episode:
            row = (d.observation, d.next_observation, d.action, np.array(d.reward), np.array(d.done), [d.info])
            if by_planner:
                self.planner.add(*row)
            else:
                super().add(*row)

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> ReplayBufferSamples:
        """Draw a batch with replacement: half of it, rounded up, from `planner`; all from one where the other is empty.

        Args:
            batch_size: Decisions to draw.
            env: Normalises them, as in SB3.

        Raises:
            ValueError: Both buffers are empty.
        """
        if not self.decisions:
            raise ValueError("Both replay buffers are empty: no episode with a decision has ended yet.")
        n = batch_size if not self.size() else (batch_size + 1) // 2 if self.planner.size() else 0
        drawn = [
            buffer._get_samples(self.rng.integers(buffer.size(), size=share), env=env)
            for buffer, share in ((self.planner, n), (self, batch_size - n))
            if share
        ]
        columns = ("observations", "actions", "next_observations", "dones", "rewards")
        return ReplayBufferSamples(*(th.cat([getattr(part, column) for part in drawn]) for column in columns))

    @property
    def decisions(self) -> int:
        """Decisions in both buffers."""
        return self.size() + self.planner.size()

    def forget_unfinished(self) -> None:
        """Drop the episodes under way: their envs are reset."""
        for episode in self._episodes:
            episode.clear()

    def state(self) -> dict[str, NDArray[np.float32]]:
        """Return what both buffers hold, the oldest decision first: arrays by names such as "planner.rewards"."""
        return {
            f"{name}.{column}": np.roll(getattr(buffer, column)[: buffer.size()], -buffer.pos, axis=0)
            for name, buffer in self._buffers().items()
            for column in ROWS
        }

    def restore(self, state: Mapping[str, NDArray[np.float32]]) -> None:
        """Fill the buffers with what `state` returned, and drop the episodes under way.

        Raises:
            KeyError: An array is missing.
            ValueError: The arrays do not fit these buffers.
        """
        for name, buffer in self._buffers().items():
            rows = len(state[f"{name}.rewards"])
            for column in ROWS:
                given, kept = state[f"{name}.{column}"], getattr(buffer, column)
                if given.shape[1:] != kept.shape[1:] or len(given) != rows or rows > buffer.buffer_size:
                    raise ValueError(f"{name}.{column} has shape {given.shape}, expected at most {kept.shape}")
                kept[:rows] = given
            buffer.full, buffer.pos = rows == buffer.buffer_size, rows % buffer.buffer_size
        self.forget_unfinished()

    def _buffers(self) -> dict[str, ReplayBuffer]:
        return {"online": self, "planner": self.planner}
