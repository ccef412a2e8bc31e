"""The mathematics of FrontierGRPO: advantages, the frontier filter and the clipped loss (Eq. 7-9)."""

from __future__ import annotations

import numpy as np
import torch as th
from numpy.typing import NDArray

from dynaforge.algos.options import AdvantageScale, GroupFilter, check_choice
from dynaforge.geometry import Array

RETURN_TOLERANCE = 1e-9  # Differences below this are rounding of reward sums, not outcomes.


def group_advantages(
    returns: Array,
    *,
    scale: AdvantageScale = "group",
    success: NDArray[np.bool_] | None = None,
    eps: float = 1e-4,
) -> Array:
    """Compare each rollout with the other rollouts of its condition.

    Eq. 7. The paper leaves the standard deviation open; this is the sample one (ddof=1), as common GRPO
    implementations use, and equal returns give exact zeros.

    Args:
        returns: Episodic returns, shape (N, K).
        scale: "group" divides by the group's deviation (the paper), "batch" by that of all centred returns
            given here, "none" only centres. "learnability" multiplies by 8 p (1 - p), p being the group's share of
            successes: a group of equal halves then counts about as under "group", and a lone dissenter, which the
            division makes as loud as it, counts least.
        success: Terminal success, shape (N, K); read by "learnability" only.
        eps: Added to the deviation: keeps float noise from becoming an advantage.

    Returns:
        Advantages, shape (N, K); each row has mean zero.

    Raises:
        ValueError: K < 2, since a lone rollout has nothing to be compared with; an unknown scale; or
            "learnability" without success.
    """
    check_choice("scale_advantage", scale)
    if returns.ndim != 2 or returns.shape[1] < 2:
        raise ValueError(f"Returns must have shape (N, K) with K >= 2 rollouts per group; given {returns.shape}.")
    # Equal returns differ from their mean by rounding alone, which a deviation near zero would blow up.
    equal = np.ptp(returns, axis=1, keepdims=True) <= RETURN_TOLERANCE
    # Critic-free: K rollouts of one condition estimate its value by their mean. That needs no network, and unlike a
    # learned value it cannot lag behind the policy.
    centred = np.where(equal, 0.0, returns - returns.mean(axis=1, keepdims=True))
    if scale == "none" or centred.size == 0:
        return centred
    if scale == "learnability":
        if success is None:
            raise ValueError("scale_advantage='learnability' weighs a group by its successes, and none are given.")
        # p (1 - p) is at most 1/4, and returns lie at most 1/2 from the mean of such a group: the largest is 1.
        rate = success.mean(axis=1, keepdims=True)
        return np.asarray(8.0 * rate * (1.0 - rate) * centred)
    # ddof=1: K returns are a sample of what the policy earns. Dividing by K would underestimate their spread, by 6.5 %
    # at K = 8, and so enlarge every advantage of a small group.
    deviation = centred.std(axis=1, ddof=1, keepdims=True) if scale == "group" else centred.std(ddof=1)
    return np.asarray(centred / (deviation + eps))


def frontier_mask(
    success: NDArray[np.bool_], returns: Array, *, group_filter: GroupFilter = "mixed_success"
) -> NDArray[np.bool_]:
    """Return which groups take part in the update.

    Eq. 8: keep a group when some of its rollouts succeeded and some failed. The filter reads success, not
    return: an all-failure group with unequal progress is dropped.

    Args:
        success: Terminal success, shape (N, K).
        returns: Episodic returns, shape (N, K); read by "mixed_return" only.
        group_filter: "mixed_success" (the paper), "margin" (at least two successes and two failures, so that no
            group is kept for a lone dissenter), "mixed_return" (any difference in return, for envs without a success
            signal), or "none" (vanilla GRPO: all groups).

    Returns:
        True for kept groups, shape (N,).

    Raises:
        ValueError: Unknown filter.
    """
    check_choice("group_filter", group_filter)
    if group_filter == "none":
        return np.ones(len(returns), dtype=bool)
    if group_filter == "mixed_return":
        return np.asarray(np.ptp(returns, axis=1) > RETURN_TOLERANCE)
    wins, least = success.sum(axis=1), 2 if group_filter == "margin" else 1
    return np.asarray((wins >= least) & (wins <= success.shape[1] - least))


def clipped_surrogate(
    log_prob: th.Tensor, old_log_prob: th.Tensor, advantages: th.Tensor, *, clip_low: float, clip_high: float
) -> th.Tensor:
    """Return the loss of each transition: -min(rho A, clip(rho, 1 - clip_low, 1 + clip_high) A).

    Eq. 9 before the mean. The paper takes DAPO's asymmetric pair, 0.20 and 0.28: the wider upper side lets a
    rare good action gain probability faster.

    Args:
        log_prob: Under the policy being trained, shape (n,).
        old_log_prob: Under the policy that acted, shape (n,).
        advantages: Of the transition's episode, shape (n,).
        clip_low: How far the ratio may fall below 1.
        clip_high: How far it may rise above 1.

    Returns:
        Losses, shape (n,), not yet averaged.
    """
    # Importance weight rho: the actions were sampled from the old policy, the gradient is that of the new one.
    ratio = th.exp(log_prob - old_log_prob)
    clipped = ratio.clamp(1.0 - clip_low, 1.0 + clip_high)
    # The smaller of the two: going beyond the range in the advantage's direction brings nothing, and so has no
    # gradient, whereas a ratio that moved the wrong way keeps its full gradient.
    return -th.minimum(ratio * advantages, clipped * advantages)


def estimated_kl(log_prob: th.Tensor, old_log_prob: th.Tensor) -> th.Tensor:
    """Estimate KL(old || new) at each transition from the action taken there.

    Args:
        log_prob: Under the policy being trained, shape (n,).
        old_log_prob: Under the policy that acted, shape (n,).

    Returns:
        Estimates, shape (n,), each at least 0.
    """
    # Schulman's k3, (rho - 1) - log rho with actions of the old policy. Like -log rho it is unbiased, since rho has
    # mean 1, but it varies less and is never negative: a single batch cannot show a divergence below 0.
    log_ratio = log_prob - old_log_prob
    return (log_ratio.exp() - 1.0) - log_ratio
