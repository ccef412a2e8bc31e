"""The optimizer's side of an update, on transitions made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch as th
from gymnasium import spaces

from dynaforge.algos.buffer import KeptTransitions
from dynaforge.algos.policies import CriticFreePolicy
from dynaforge.algos.update import UpdateSettings, update_policy

HERE, THERE = th.zeros(64, 3), th.ones(64, 3)


def fresh_policy() -> CriticFreePolicy:
    th.manual_seed(0)
    box = spaces.Box(-1.0, 1.0, (3,), np.float32)
    return CriticFreePolicy(box, spaces.Box(-1.0, 1.0, (2,), np.float32), lambda _: 3e-3, net_arch=[16])


def acted(policy: CriticFreePolicy, observations: th.Tensor, seed: int) -> KeptTransitions:
    """Sample actions; those to the right are better."""
    th.manual_seed(seed)
    with th.no_grad():
        distribution = policy.get_distribution(observations)
        actions = distribution.sample()
        log_probs = distribution.log_prob(actions)
    return KeptTransitions(
        observations=observations,
        actions=actions,
        log_probs=log_probs,
        advantages=th.sign(actions[:, 0]),
        weights=th.ones(len(actions)),
    )


def settings(**changes: float) -> UpdateSettings:
    plain = UpdateSettings(
        learning_rate=3e-3,
        n_epochs=10,
        batch_size=16,
        clip_low=0.2,
        clip_high=0.28,
        kl_coef=0.0,
        anchor_coef=0.0,
        rim_coef=0.0,
        target_kl=None,
        desired_kl=None,
        max_grad_norm=0.5,
    )
    return replace(plain, **changes)


def moved(anchor_coef: float, anchored_at: th.Tensor | None) -> tuple[float, float, int]:
    """Return how far the mean moved here and there, and the optimizer steps, of an update with data from here alone."""
    policy = fresh_policy()
    kept = acted(policy, HERE, 1)
    anchored = None if anchored_at is None else acted(policy, anchored_at, 2)
    before = [policy.get_distribution(where[:1]).mode().detach() for where in (HERE, THERE)]
    report = update_policy(
        policy, kept, settings(anchor_coef=anchor_coef), rng=np.random.default_rng(0), anchors=anchored
    )
    after = [policy.get_distribution(where[:1]).mode().detach() for where in (HERE, THERE)]
    here, there = (float((b - a).norm()) for a, b in zip(before, after, strict=True))
    return here, there, report.optimizer_steps


def test_an_anchor_keeps_the_policy_where_it_always_succeeds_and_costs_no_optimizer_step() -> None:
    here, there, steps = moved(0.0, None)
    held_here, held_there, held_steps = moved(10.0, THERE)
    assert there > 0.01, "without an anchor the mean drifts where nothing was learned"
    assert held_there < 0.5 * there
    assert held_here > 0.5 * here
    assert steps == held_steps == 10 * 4


def test_an_anchor_of_weight_zero_or_without_transitions_changes_nothing() -> None:
    plain = moved(0.0, None)
    assert moved(10.0, th.zeros(0, 3)) == plain


@pytest.mark.parametrize("coefficient", ["kl_coef", "anchor_coef"])
def test_a_penalty_on_the_divergence_shortens_the_step(coefficient: str) -> None:
    free, _, _ = moved(0.0, None)
    policy = fresh_policy()
    kept = acted(policy, HERE, 1)
    before = policy.get_distribution(HERE[:1]).mode().detach()
    update_policy(policy, kept, settings(**{coefficient: 10.0}), rng=np.random.default_rng(0), anchors=kept)
    assert float((policy.get_distribution(HERE[:1]).mode().detach() - before).norm()) < free
