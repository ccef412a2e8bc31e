"""A learning rate that follows the KL divergence of the updates."""

from __future__ import annotations

import numpy as np
import pytest
from small_models import envs, equal, small, weights

from dynaforge.algos import FrontierGRPO, learning
from dynaforge.algos.adaptive_rate import followed
from dynaforge.algos.learning import learned_state, restore_learned_state
from dynaforge.algos.update import update_policy

PLAIN = {"group_filter": "none", "batch_size": 16}


@pytest.mark.parametrize(
    ("factor", "kl", "expected"),
    [
        (0.6, 0.11, 0.4),  # above twice the desired KL
        (0.6, 0.02, 0.9),  # below half of it
        (0.6, 0.099, 0.6),
        (0.6, 0.026, 0.6),
        (0.9, 0.0, 1.0),  # never above the scheduled rate
        (0.011, 9.9, 0.01),  # nor below a hundredth of it
    ],
)
def test_the_factor_follows_the_divergence_within_bounds(factor, kl, expected):
    assert followed(factor, kl, 0.05) == pytest.approx(expected)


def test_the_rate_is_the_scheduled_one_times_the_factor():
    model = small(envs(4), **PLAIN, learning_rate=1e-2, desired_kl=1e-6)
    rates = []
    for _ in range(3):
        model.learn(1, reset_num_timesteps=False)
        rates.append(model.policy.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-2, 1e-2 / 1.5, 1e-2 / 1.5**2])
    assert model.rate_factor == pytest.approx(1.5**-3)


def test_the_updates_come_to_the_desired_divergence(monkeypatch):
    reports = []

    def note(*args, **kwargs):
        reports.append(update_policy(*args, **kwargs))
        return reports[-1]

    monkeypatch.setattr(learning, "update_policy", note)
    small(envs(16), n_groups=8, group_size=8, **PLAIN, learning_rate=0.1, desired_kl=0.005).learn(24 * 64 * 3)
    far = [max(report.update_kl, report.approx_kl) for report in reports]
    assert min(far[:2]) > 0.05, "at the scheduled rate an update goes ten times too far"
    assert 0.00125 < np.median(far[-12:]) < 0.02


def test_the_divergence_of_an_update_is_that_between_the_policies_before_and_after(logged):
    model = small(envs(4), group_filter="none", batch_size=7, learning_rate=1e-2, desired_kl=0.01)
    values = logged(model)
    model.learn(1)
    kept = model.rollout_buffer.keep(np.ones(4, dtype=bool), np.zeros((4, 4)))
    log_ratio = model.policy.get_distribution(kept.observations).log_prob(kept.actions) - kept.log_probs
    log_ratio = log_ratio.detach()
    expected = float((log_ratio.exp() - 1 - log_ratio).mean())
    model.learn(1, reset_num_timesteps=False)  # dumps what the first update logged
    assert values["train/update_kl"] == pytest.approx(expected, rel=1e-4)
    assert expected > 0
    unused = small(envs(4), group_filter="none")
    values = logged(unused)
    unused.learn(1)
    unused.learn(1, reset_num_timesteps=False)
    assert "train/update_kl" not in values, "another pass over the transitions, only to be logged"


def test_a_saved_model_keeps_its_rate(tmp_path):
    options = {"learning_rate": 0.1, "batch_size": 8, "group_filter": "mixed_return", "desired_kl": 0.02}
    first = small(envs(3), **options).learn(144)
    assert first.rate_factor < 1.0
    first.save(tmp_path / "m")
    whole = small(envs(3), **options).learn(144)
    whole.learn(144, reset_num_timesteps=False)
    resumed = FrontierGRPO.load(tmp_path / "m", env=first.env, device="cpu")
    assert resumed.rate_factor == first.rate_factor
    resumed.learn(144, reset_num_timesteps=False)
    assert equal(weights(whole), weights(resumed))

    fresh = small(envs(3), **options)
    restore_learned_state(fresh, learned_state(first))
    assert fresh.rate_factor == first.rate_factor
    with pytest.raises(KeyError, match="rate_factor"):
        restore_learned_state(fresh, learned_state(small(envs(3))))
