"""What the episodes of an update came to, group by group."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.logger import Logger

from dynaforge.algos.advantages import frontier_mask
from dynaforge.geometry import Array, one_line
from dynaforge.sampling.dispatch import FinishedEpisode
from dynaforge.sampling.sampler import Group


@dataclass(frozen=True)
class GroupOutcomes:
    """Outcomes of N groups of K rollouts.

    Attributes:
        returns: Episodic returns, shape (N, K).
        success: Terminal success, shape (N, K); None when the env does not say. Beside episodes that do, one that was
            cut off before its env said anything counts as a failure.
        strata: Stratum of each group, shape (N,); -1 where drawn from the whole range.
        conditions: Condition of each group.
    """

    returns: Array
    success: NDArray[np.bool_] | None
    strata: NDArray[np.int64]
    conditions: tuple[Any, ...]

    __repr__ = one_line

    @staticmethod
    def of(groups: Sequence[Group], episodes: Mapping[int, FinishedEpisode], group_size: int) -> GroupOutcomes:
        """Arrange finished episodes, keyed by job index, as one row a group."""
        rows = [[episodes[group.index * group_size + k] for k in range(group_size)] for group in groups]
        told = [episode.success is not None for row in rows for episode in row]
        known = any(told) and all(t or e.truncated for t, e in zip(told, itertools.chain(*rows), strict=True))
        return GroupOutcomes(
            returns=np.array([[episode.total_reward for episode in row] for row in rows]),
            success=np.array([[bool(episode.success) for episode in row] for row in rows]) if known else None,
            strata=np.array([-1 if group.stratum is None else group.stratum for group in groups]),
            conditions=tuple(group.condition for group in groups),
        )

    def kept(self, group_filter: str) -> NDArray[np.bool_]:
        """Say which groups the filter keeps, shape (N,) (Eq. 8)."""
        success = np.zeros(self.returns.shape, dtype=bool) if self.success is None else self.success
        return frontier_mask(success, self.returns, group_filter=group_filter)

    def log(self, logger: Logger) -> None:
        """Record the shares of all-success, mixed and all-failure groups, and success by stratum."""
        if self.success is None:
            return
        rate = self.success.mean(axis=1)
        logger.record("frontier/share_all_success", float(np.mean(rate == 1.0)))
        logger.record("frontier/share_all_fail", float(np.mean(rate == 0.0)))
        logger.record("frontier/share_mixed", float(np.mean((rate > 0.0) & (rate < 1.0))))
        for stratum, value in zip(self.strata.tolist(), rate.tolist(), strict=True):
            if stratum >= 0:
                logger.record(f"frontier/success_stratum_{stratum:02d}", value)
