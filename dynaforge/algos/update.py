"""The optimizer's side of an update: epochs over the kept transitions (Eq. 9)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import update_learning_rate

from dynaforge.algos.advantages import clipped_surrogate, estimated_kl
from dynaforge.algos.buffer import KeptTransitions
from dynaforge.algos.options import scheduled
from dynaforge.algos.rim import rim_penalty


@dataclass(frozen=True, kw_only=True)
class UpdateSettings:
    """Settings of one update, schedules already evaluated; see `FrontierGRPO` for their meaning."""

    learning_rate: float
    n_epochs: int
    batch_size: int | None
    clip_low: float
    clip_high: float
    kl_coef: float
    anchor_coef: float
    rim_coef: float
    target_kl: float | None
    desired_kl: float | None
    max_grad_norm: float

    @staticmethod
    def of(model: Any, progress: float) -> UpdateSettings:
        """Read the options of a FrontierGRPO model at this much remaining progress."""
        rate = scheduled("learning_rate", model.lr_schedule, progress)
        if model.scale_learning_rate == "failures" and model.last_group_success is not None:
            # Eq. 7 scales each kept group to the same deviation, whether one of its rollouts failed or all but one: a
            # policy that hardly ever fails would change as much per update as one that has everything to learn.
            rate *= 1.0 - float(model.last_group_success.mean())
        if model.desired_kl is not None:
            rate *= model.rate_factor
        return UpdateSettings(
            learning_rate=rate,
            n_epochs=model.n_epochs,
            batch_size=model.batch_size,
            clip_low=scheduled("clip_range", model.clip_range, progress),
            clip_high=scheduled("clip_range_high", model.clip_range_high, progress),
            kl_coef=model.kl_coef,
            anchor_coef=model.anchor_coef,
            rim_coef=model.rim_coef,
            target_kl=model.target_kl,
            desired_kl=model.desired_kl,
            max_grad_norm=model.max_grad_norm,
        )


@dataclass(frozen=True, kw_only=True)
class UpdateReport:
    """What an update did; losses are means over its minibatches.

    Attributes:
        loss: Whole loss.
        policy_gradient_loss: Its surrogate part.
        approx_kl: KL(old || new), estimated on the kept transitions.
        update_kl: The same at the end of the update: how far it went. Costs another pass over the transitions, so that
            it is measured only where the rate follows it (`desired_kl`), else None.
        clip_fraction: Share of ratios outside the clip range.
        n_epochs: Epochs begun.
        optimizer_steps: Steps taken.
        learning_rate: What the optimizer worked with.
        std: Mean exploration noise after the update; None for a policy without sigma.
    """

    loss: float
    policy_gradient_loss: float
    approx_kl: float
    update_kl: float | None
    clip_fraction: float
    n_epochs: int
    optimizer_steps: int
    learning_rate: float
    std: float | None

    def log(self, logger: Logger) -> None:
        """Record losses, rate and noise under train/, named as SB3's PPO names them; nothing for what is None."""
        names = ("learning_rate", "loss", "policy_gradient_loss", "approx_kl", "update_kl", "clip_fraction", "std")
        for name in names:
            if (value := getattr(self, name)) is not None:
                logger.record(f"train/{name}", value)


def update_policy(
    policy: ActorCriticPolicy,
    kept: KeptTransitions,
    settings: UpdateSettings,
    *,
    rng: np.random.Generator,
    anchors: KeptTransitions | None = None,
) -> UpdateReport:
    """Improve the policy on the kept transitions (Eq. 9).

    Args:
        policy: Changed in place, by its own optimizer.
        kept: At least one transition.
        settings: Epochs, clip range and so on.
        rng: Order of the minibatches.
        anchors: Transitions on which the policy shall stay as it is, at weight `settings.anchor_coef`; spread over
            the minibatches of `kept`, whose number they do not change.

    Raises:
        FloatingPointError: Ratio, loss or gradient is NaN or infinite; raised before the optimizer moves.
    """
    update_learning_rate(policy.optimizer, settings.learning_rate)
    figures: list[th.Tensor] = []
    epochs = steps = 0
    stopped = False
    n_batches = 1 if settings.batch_size is None else -(-len(kept) // settings.batch_size)
    # Every minibatch divides by the same number, the mean minibatch size, and not by its own: a transition then
    # weighs the same in whichever minibatch it falls.
    normaliser = len(kept) / n_batches
    trained = [parameter for parameter in policy.parameters() if parameter.requires_grad]
    while epochs < settings.n_epochs and not stopped:
        epochs += 1
        batches = kept.minibatches(n_batches, rng)
        anchor_batches = repeat(None) if anchors is None else anchors.minibatches(n_batches, rng)
        for batch, anchor in zip(batches, anchor_batches, strict=False):
            loss, batch_figures = _loss(policy, batch, settings, normaliser)
            if anchor is not None and len(anchor):
                # KL(old || new) where every rollout succeeds: the filter leaves no other term there, so without this
                # one nothing would keep an update from undoing what has been learned.
                log_prob = policy.get_distribution(anchor.observations).log_prob(anchor.actions)
                loss = loss + settings.anchor_coef * estimated_kl(log_prob, anchor.log_probs).mean()
            figures.append(batch_figures)
            # SB3's PPO stops at 1.5 times the target too, and before the step that would go further.
            if settings.target_kl is not None and float(batch_figures[2]) > 1.5 * settings.target_kl:
                stopped = True
                break
            policy.optimizer.zero_grad()
            loss.backward()
            _refuse_bad_gradient(policy, th.nn.utils.clip_grad_norm_(trained, settings.max_grad_norm))
            policy.optimizer.step()
            steps += 1
    mean_loss, surrogate, kl, outside = th.stack(figures).mean(dim=0).tolist()
    return UpdateReport(
        loss=mean_loss,
        policy_gradient_loss=surrogate,
        approx_kl=kl,
        update_kl=None if settings.desired_kl is None else _distance(policy, kept, settings.batch_size),
        clip_fraction=outside,
        n_epochs=epochs,
        optimizer_steps=steps,
        learning_rate=settings.learning_rate,
        std=th.exp(policy.log_std).mean().item() if hasattr(policy, "log_std") else None,
    )


def _loss(
    policy: ActorCriticPolicy, batch: KeptTransitions, settings: UpdateSettings, normaliser: float
) -> tuple[th.Tensor, th.Tensor]:
    """Return the loss of a minibatch and its figures: loss, surrogate, approximate KL, clip fraction."""
    distribution = policy.get_distribution(batch.observations)
    log_prob = distribution.log_prob(batch.actions)
    losses = clipped_surrogate(
        log_prob, batch.log_probs, batch.advantages, clip_low=settings.clip_low, clip_high=settings.clip_high
    )
    # Eq. 9's mean over I_F. The weights have mean 1: all equal for a mean over transitions, 1 / length for one over
    # episodes.
    surrogate = (batch.weights * losses).sum() / normaliser
    kl = estimated_kl(log_prob, batch.log_probs)
    if settings.kl_coef > 0.0:
        # The old policy is the one that acted, so this only bounds the update; there is no reference policy as in
        # GRPO for language models, which keeps close to a pretrained one.
        loss = surrogate + settings.kl_coef * (batch.weights * kl).sum() / normaliser
    else:
        loss = surrogate
    if settings.rim_coef > 0.0:
        outside_box = rim_penalty(distribution, policy.action_space)
        loss = loss + settings.rim_coef * (batch.weights * outside_box).sum() / normaliser
    with th.no_grad():
        ratio = (log_prob - batch.log_probs).exp()
        outside = ((ratio < 1.0 - settings.clip_low) | (ratio > 1.0 + settings.clip_high)).float().mean()
        figures = th.stack([loss, surrogate, kl.mean(), outside])
    if not bool(th.isfinite(figures).all()):
        bad = th.nonzero(~th.isfinite(ratio)).flatten().tolist()
        raise FloatingPointError(
            f"The probability ratio of {len(bad)} of {len(batch)} transitions is not finite (loss {loss.item()}). "
            "The policy was left as it was before this step; lower learning_rate or set target_kl."
        )
    return loss, figures


@th.no_grad()
def _distance(policy: ActorCriticPolicy, kept: KeptTransitions, batch_size: int | None) -> float:
    """Return the mean estimate of KL(old || new) over the kept transitions."""
    total = 0.0
    for part in kept.in_order(batch_size):
        log_prob = policy.get_distribution(part.observations).log_prob(part.actions)
        total += float(estimated_kl(log_prob, part.log_probs).sum())
    return total / len(kept)


def _refuse_bad_gradient(policy: ActorCriticPolicy, norm: th.Tensor) -> None:
    if bool(th.isfinite(norm)):
        return
    bad = [n for n, p in policy.named_parameters() if p.grad is not None and not bool(th.isfinite(p.grad).all())]
    raise FloatingPointError(
        f"The gradient of {', '.join(bad) or 'the loss'} is not finite (norm {norm.item()}). "
        "The policy was left as it was before this step; lower learning_rate or set target_kl."
    )
