"""What the groups of an update came to: returns and success of every rollout."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.logger import Logger

from dynaforge.algos.advantages import frontier_mask
from dynaforge.algos.options import GroupFilter
from dynaforge.geometry import Array, one_line
from dynaforge.sampling.dispatch import FinishedEpisode
from dynaforge.sampling.sampler import Group


@dataclass(frozen=True)
class GroupResults:
    """Returns and success of N groups of K rollouts: what the filter and the advantages are computed from.

    Attributes:
        groups: The groups, in the order of their indices.
        returns: Episodic returns, shape (N, K).
        success: Terminal success, shape (N, K); None when the env does not report it. When it does, an episode that
            was cut off before a report counts as a failure.
    """

    groups: tuple[Group, ...]
    returns: Array
    success: NDArray[np.bool_] | None

    __repr__ = one_line

    @staticmethod
    def of(episodes: Iterable[FinishedEpisode]) -> GroupResults:
        """Arrange the finished episodes of whole groups: one row per group, one column per rollout."""
        # Episodes finish in an order that depends on the number of envs; results must not.
        ordered = sorted(episodes, key=lambda episode: (episode.job.group.index, episode.job.rollout))
        rows: dict[Group, list[FinishedEpisode]] = {}
        for episode in ordered:
            rows.setdefault(episode.job.group, []).append(episode)
        reported = [episode.success is not None for episode in ordered]
        excused = [episode.truncated for episode in ordered]
        known = any(reported) and all(r or e for r, e in zip(reported, excused, strict=True))
        return GroupResults(
            groups=tuple(rows),
            returns=np.array([[episode.total_reward for episode in row] for row in rows.values()]),
            success=np.array([[bool(episode.success) for episode in row] for row in rows.values()]) if known else None,
        )

    @property
    def strata(self) -> NDArray[np.int64]:
        """Stratum of each group, shape (N,); -1 where it was drawn from the whole range."""
        return np.array([-1 if group.stratum is None else group.stratum for group in self.groups])

    @property
    def conditions(self) -> tuple[Any, ...]:
        """Condition of each group."""
        return tuple(group.condition for group in self.groups)

    def kept(self, group_filter: GroupFilter) -> NDArray[np.bool_]:
        """Return which groups the filter keeps, shape (N,) (Eq. 8)."""
        # Without a success signal every rollout counts as a failure, so "mixed_success" keeps nothing.
        success = np.zeros(self.returns.shape, dtype=bool) if self.success is None else self.success
        return frontier_mask(success, self.returns, group_filter=group_filter)

    def log(self, logger: Logger, group_filter: GroupFilter) -> None:
        """Record the shares of kept, all-success, mixed and all-failure groups, and success by stratum."""
        logger.record("frontier/share_kept", float(self.kept(group_filter).mean()))
        if self.success is None:
            return
        rate = self.success.mean(axis=1)
        logger.record("frontier/share_all_success", float(np.mean(rate == 1.0)))
        logger.record("frontier/share_all_fail", float(np.mean(rate == 0.0)))
        logger.record("frontier/share_mixed", float(np.mean((rate > 0.0) & (rate < 1.0))))
        for stratum in sorted({*self.strata.tolist()} - {-1}):  # several groups of one stratum count together
            logger.record(f"frontier/success_stratum_{stratum:02d}", float(rate[self.strata == stratum].mean()))
