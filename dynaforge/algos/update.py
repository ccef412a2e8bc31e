"""The optimizer's side of an update: epochs over the kept transitions (Eq. 9)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import repeat

import numpy as np
import torch as th
from stable_baselines3.common.policies import ActorCriticPolicy

from dynaforge.algos.advantages import clipped_surrogate
from dynaforge.algos.buffer import KeptTransitions


@dataclass(frozen=True)
class UpdateSettings:
    """Settings of one update, schedules already evaluated; see `FrontierGRPO` for their meaning."""

    n_epochs: int
    batch_size: int | None
    clip_low: float
    clip_high: float
    kl_coef: float
    anchor_coef: float
    target_kl: float | None
    max_grad_norm: float


@dataclass(frozen=True)
class UpdateReport:
    """What an update did; losses are means over its optimizer steps.

    Attributes:
        loss: Whole loss.
        policy_gradient_loss: Its surrogate part.
        approx_kl: KL(old || new), estimated on the kept transitions.
        clip_fraction: Share of ratios outside the clip range.
        n_epochs: Epochs begun.
        optimizer_steps: Steps taken.
        stopped_early: Whether target_kl ended the update.
    """

    loss: float
    policy_gradient_loss: float
    approx_kl: float
    clip_fraction: float
    n_epochs: int
    optimizer_steps: int
    stopped_early: bool


def update_policy(
    policy: ActorCriticPolicy,
    kept: KeptTransitions,
    settings: UpdateSettings,
    *,
    rng: np.random.Generator,
    anchored: KeptTransitions | None = None,
) -> UpdateReport:
    """Improve the policy on the kept transitions.

    Every minibatch divides by the same number, the update's transitions over its minibatches, so a step's size does
    not depend on which transitions fell into it.

    Args:
        policy: Changed in place, by its own optimizer.
        kept: At least one transition.
        settings: Epochs, clip range and so on.
        rng: Order of the minibatches.
        anchored: Transitions on which the policy shall stay as it is, at weight `settings.anchor_coef`; spread over
            the minibatches of `kept`, whose number they do not change.

    Raises:
        FloatingPointError: Ratio, loss or gradient is NaN or infinite; raised before the optimizer moves.
    """
    figures: list[th.Tensor] = []
    epochs = steps = 0
    stopped = False
    n_batches = 1 if settings.batch_size is None else -(-len(kept) // settings.batch_size)
    trained = [parameter for parameter in policy.parameters() if parameter.requires_grad]
    while epochs < settings.n_epochs and not stopped:
        epochs += 1
        parts = kept.minibatches(n_batches, rng)
        held = repeat(None) if anchored is None else anchored.minibatches(n_batches, rng)
        for batch, anchor in zip(parts, held, strict=False):
            loss, row = _loss(policy, batch, settings, len(kept) / n_batches)
            if anchor is not None and len(anchor):
                log_prob = policy.get_distribution(anchor.observations).log_prob(anchor.actions)
                loss = loss + settings.anchor_coef * _divergence(log_prob - anchor.log_probs).mean()
            figures.append(row)
            if settings.target_kl is not None and float(row[2]) > 1.5 * settings.target_kl:
                stopped = True
                break
            policy.optimizer.zero_grad()
            loss.backward()
            _refuse_bad_gradient(policy, th.nn.utils.clip_grad_norm_(trained, settings.max_grad_norm))
            policy.optimizer.step()
            steps += 1
    loss_mean, surrogate, kl, outside = th.stack(figures).mean(dim=0).tolist()
    return UpdateReport(loss_mean, surrogate, kl, outside, epochs, steps, stopped)


def _loss(
    policy: ActorCriticPolicy, batch: KeptTransitions, settings: UpdateSettings, normaliser: float
) -> tuple[th.Tensor, th.Tensor]:
    """Return the loss and the row (loss, surrogate, approximate KL, clip fraction)."""
    log_prob = policy.get_distribution(batch.observations).log_prob(batch.actions)
    losses = clipped_surrogate(
        log_prob, batch.log_probs, batch.advantages, clip_low=settings.clip_low, clip_high=settings.clip_high
    )
    surrogate = (batch.weights * losses).sum() / normaliser
    log_ratio = log_prob - batch.log_probs
    ratio = log_ratio.exp()
    if settings.kl_coef > 0.0:
        penalty = (batch.weights * _divergence(log_ratio)).sum() / normaliser
        loss = surrogate + settings.kl_coef * penalty
    else:
        loss = surrogate
    with th.no_grad():
        kl = _divergence(log_ratio).mean()
        outside = ((ratio < 1.0 - settings.clip_low) | (ratio > 1.0 + settings.clip_high)).float().mean()
        row = th.stack([loss, surrogate, kl, outside])
    if not bool(th.isfinite(row).all()):
        bad = th.nonzero(~th.isfinite(ratio)).flatten().tolist()
        raise FloatingPointError(
            f"The probability ratio of {len(bad)} of {len(batch)} transitions is not finite (loss {loss.item()}). "
            "The policy was left as it was before this step; lower learning_rate or set target_kl."
        )
    return loss, row


def _divergence(log_ratio: th.Tensor) -> th.Tensor:
    """Estimate KL(old || new) at each transition from the action taken there, shape (n,); never below 0."""
    return (log_ratio.exp() - 1.0) - log_ratio


def _refuse_bad_gradient(policy: ActorCriticPolicy, norm: th.Tensor) -> None:
    if bool(th.isfinite(norm)):
        return
    bad = [n for n, p in policy.named_parameters() if p.grad is not None and not bool(th.isfinite(p.grad).all())]
    raise FloatingPointError(
        f"The gradient of {', '.join(bad) or 'the loss'} is not finite (norm {norm.item()}). "
        "The policy was left as it was before this step; lower learning_rate or set target_kl."
    )
