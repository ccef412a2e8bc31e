"""Which strata an update draws from when those at the frontier shall come more often."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaforge.geometry import Array, one_line

MEMORY = 0.8  # of its trials, what a stratum keeps from update to update
MOST = 2  # groups of one stratum among those drawn by weight
LONGEST_WAIT = 4  # updates within which every stratum is drawn at least once


@dataclass(frozen=True, slots=True, eq=False)
class StratumRecord:
    """What is known of the success of each stratum, from its own trials alone.

    Wins and losses fade from update to update, so that the record follows the policy, and a stratum that is not drawn
    returns to the prior: a rate of success between 0 and 1, all of them equally likely. A stratum never seen is
    therefore drawn rather often.

    Attributes:
        wins: Rollouts that succeeded, faded, shape (N,).
        losses: Rollouts that failed, faded, shape (N,).
        waits: Updates since the stratum was last drawn, shape (N,).
    """

    wins: Array
    losses: Array
    waits: Array

    __repr__ = one_line

    @staticmethod
    def empty(n_strata: int) -> StratumRecord:
        """Return the record of strata that were never drawn."""
        return StratumRecord(*(np.zeros(n_strata) for _ in range(3)))

    @property
    def success(self) -> Array:
        """Trailing rate of success of each stratum, w / (w + l), shape (N,); NaN before its first trial."""
        trials = self.wins + self.losses
        return np.asarray(np.divide(self.wins, trials, out=np.full(len(trials), np.nan), where=trials > 0))

    @property
    def learnability(self) -> Array:
        """Expected p (1 - p) of each stratum under its Beta(w + 1, l + 1), shape (N,): at most 1/4, unseen 1/6."""
        won, lost = self.wins + 1.0, self.losses + 1.0
        return won * lost / ((won + lost) * (won + lost + 1.0))

    def draw(self, rng: np.random.Generator) -> list[int]:
        """Choose N strata in proportion to their learnability, in order of difficulty.

        p (1 - p) is the variance of a rollout's success: where it is 0, rollouts cannot be told apart (Tzannetos et al.
        2023, "Proximal curriculum for reinforcement learning agents"; Rutherford et al. 2024 call it learnability).
        The paper draws each stratum once instead. Every stratum is drawn within `LONGEST_WAIT` updates, and by weight
        none has more than `MOST` groups, so that an update never rests on a few strata alone.

        Args:
            rng: Source of all randomness.
        """
        overdue = self.waits >= LONGEST_WAIT - 1
        n = len(self.wins)
        # Systematic sampling: a stratum's number is its share rounded down or up, and their sum is exact.
        edges = np.cumsum(capped_shares(self.learnability, n - int(overdue.sum()), MOST))
        edges[-1] = n - int(overdue.sum())
        counts = np.diff(np.floor(edges + rng.random()), prepend=0.0).astype(int) + overdue
        return np.repeat(np.arange(n), counts).tolist()

    def after(self, strata: Sequence[int] | NDArray[np.int64], success: ArrayLike | None) -> StratumRecord:
        """Return the record one update later.

        Args:
            strata: Stratum of each group that was run, shape (G,).
            success: Success of its rollouts, shape (G, K); None when it is not known.
        """
        n = len(self.wins)
        drawn = np.bincount(strata, minlength=n) > 0
        won, lost = np.zeros(n), np.zeros(n)
        if success is not None:
            outcomes = np.asarray(success, dtype=float)
            np.add.at(won, strata, outcomes.sum(axis=1))
            np.add.at(lost, strata, (1.0 - outcomes).sum(axis=1))
        return StratumRecord(
            MEMORY * self.wins + won, MEMORY * self.losses + lost, np.where(drawn, 0.0, self.waits + 1.0)
        )


def capped_shares(weights: Array, total: float, cap: float) -> Array:
    """Share a total in proportion to weights, none above a cap; what the cap cuts off goes to the others.

    Args:
        weights: Positive, shape (N,).
        total: What is shared, at most N * cap.
        cap: Largest share.
    """
    shares, free = np.full(len(weights), float(cap)), np.ones(len(weights), dtype=bool)
    while free.any():
        shares[free] = (total - cap * np.count_nonzero(~free)) * weights[free] / weights[free].sum()
        over = free & (shares > cap)
        if not over.any():
            break
        shares[over], free = cap, free & ~over
    return shares
