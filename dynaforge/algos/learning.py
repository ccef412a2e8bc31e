"""The learning side of an iteration: from the results of its groups to a changed policy (Eq. 7-9)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.algos.adaptive_rate import followed
from dynaforge.algos.advantages import group_advantages
from dynaforge.algos.buffer import KeptTransitions
from dynaforge.algos.group_results import GroupResults
from dynaforge.algos.rim import has_rim
from dynaforge.algos.update import UpdateReport, UpdateSettings, update_policy
from dynaforge.geometry import Array
from dynaforge.sampling.frontier_strata import StratumRecord


def learn_from(model: Any, results: GroupResults) -> tuple[KeptTransitions, UpdateReport | None]:
    """Update a FrontierGRPO's policy on the groups that its filter keeps.

    Args:
        model: Has the options, the policy, and the transitions of the groups in its rollout buffer.
        results: Returns and success of all groups of the iteration.

    Returns:
        The transitions that were kept, and what the update did; None if none were kept, and nothing was changed.
    """
    # Eq. 8 comes before Eq. 7: with scale_advantage="batch" the deviation is then that of the groups that take part,
    # and does not shrink when many others earn equal returns throughout.
    keep = results.kept(model.group_filter)
    _log_rim(model)
    advantages = np.zeros_like(results.returns)
    success = None if results.success is None else results.success[keep]
    advantages[keep] = group_advantages(results.returns[keep], scale=model.scale_advantage, success=success)
    kept = model.rollout_buffer.keep(keep, advantages, loss_agg=model.loss_agg)
    if not len(kept):
        return kept, None
    model.policy.set_training_mode(True)
    settings = UpdateSettings.of(model, model._current_progress_remaining)
    anchors = _anchors(model, results, keep)
    report = update_policy(model.policy, kept, settings, rng=model.minibatch_rng, anchors=anchors)
    if model.desired_kl is not None:
        # An update that overshoots and returns went far too, which only the mean over its steps shows.
        assert report.update_kl is not None
        went = max(report.update_kl, report.approx_kl)
        model.rate_factor = followed(model.rate_factor, went, model.desired_kl)
    return kept, report


def log_counters(model: Any, share_used: float) -> None:
    """Record what a FrontierGRPO has counted so far, and the share of the iteration's transitions that it used."""
    model.logger.record("train/n_updates", model._n_updates, exclude="tensorboard")
    model.logger.record("train/optimizer_steps", model.optimizer_steps)
    model.logger.record("frontier/transitions_used", model.transitions_used)
    model.logger.record("frontier/share_transitions_used", share_used)
    model.logger.record("frontier/skipped_updates", model.skipped_updates)


def fitting_record(model: Any) -> StratumRecord | None:
    """Return the record of strata that a FrontierGRPO's options ask for: its own, or a new one if that does not fit."""
    record: StratumRecord | None = model.stratum_record
    if model.stratum_weights == "equal":
        return None
    return record if record is not None and len(record.wins) == model.n_groups else StratumRecord.empty(model.n_groups)


def remember(model: Any, results: GroupResults) -> None:
    """Add an iteration's groups to a FrontierGRPO's record of its strata, if it keeps one."""
    if model.stratum_record is None:
        return
    model.stratum_record = model.stratum_record.after(results.strata, results.success)
    if results.success is not None:
        # The mean over strata, each from its own trials: the groups drawn are mostly those of the frontier.
        model.logger.record("frontier/success", float(np.nanmean(model.stratum_record.success)))


def learned_state(model: Any) -> dict[str, Array]:
    """Return what a FrontierGRPO has learned besides its weights, by name: what a training checkpoint keeps of it."""
    state: dict[str, Array] = {} if model.desired_kl is None else {"rate_factor": np.array([model.rate_factor])}
    if model.stratum_record is not None:
        state |= {name: getattr(model.stratum_record, name) for name in StratumRecord.__slots__}
    return state


def restore_learned_state(model: Any, state: Mapping[str, Array]) -> None:
    """Give a FrontierGRPO, built with the same options, what `learned_state` returned.

    Raises:
        KeyError: It lacks something that the options ask for.
    """
    if model.desired_kl is not None:
        model.rate_factor = float(state["rate_factor"][0])
    if model.stratum_record is not None:
        model.stratum_record = StratumRecord(*(np.array(state[name]) for name in StratumRecord.__slots__))


def _log_rim(model: Any) -> None:
    """Record the share of the iteration's decisions whose mean was at the rim of the action box; NaN without any."""
    if has_rim(model.policy):
        buffer = model.rollout_buffer
        decisions = int(buffer.mask.sum())
        at_rim = int((buffer.at_rim & buffer.mask).sum())
        model.logger.record("train/rim_fraction", at_rim / decisions if decisions else math.nan)


def _anchors(model: Any, results: GroupResults, keep: NDArray[np.bool_]) -> KeptTransitions | None:
    """Return the transitions of the groups that were dropped because they succeeded throughout."""
    if not model.anchor_coef or results.success is None:
        return None
    anchors: KeptTransitions = model.rollout_buffer.keep(
        results.success.all(axis=1) & ~keep, np.zeros_like(results.returns)
    )
    return anchors
