from __future__ import annotations

import numpy as np
import pytest
import torch as th

from dynaforge.algos.advantages import clipped_surrogate, frontier_mask, group_advantages


def test_advantages_match_a_group_worked_by_hand():
    # mean 0.5; centred +-0.5; sample deviation sqrt(4 * 0.25 / 3) = 0.57735
    advantages = group_advantages(np.array([[1.0, 0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(advantages, [[0.86588, -0.86588, 0.86588, -0.86588]], atol=1e-5)


@pytest.mark.parametrize("scale", ["group", "batch", "none"])
def test_every_group_has_mean_advantage_zero(scale):
    returns = np.random.default_rng(0).random((7, 5))
    np.testing.assert_allclose(group_advantages(returns, scale=scale).mean(axis=1), 0.0, atol=1e-12)


@pytest.mark.parametrize("scale", ["group", "batch", "none"])
def test_equal_returns_give_exact_zeros(scale):
    returns = np.array([[0.1, 0.1, 0.1], [0.0, 0.5, 1.0]])
    advantages = group_advantages(returns, scale=scale)
    assert (advantages[0] == 0.0).all()
    assert (advantages[1] != 0.0).any()


def test_batch_scale_divides_all_groups_by_one_deviation():
    returns = np.array([[0.0, 1.0], [0.4, 0.6]])
    advantages = group_advantages(returns, scale="batch", eps=0.0)
    # centred -.5 .5 -.1 .1: sample deviation sqrt(0.52 / 3) = 0.41633
    np.testing.assert_allclose(advantages, np.array([[-0.5, 0.5], [-0.1, 0.1]]) / 0.416333, atol=1e-5)


def test_group_advantages_ignore_the_scale_of_returns_and_none_does_not():
    returns = np.array([[0.0, 1.0, 3.0]])
    np.testing.assert_allclose(group_advantages(returns * 10, eps=0.0), group_advantages(returns, eps=0.0), atol=1e-12)
    np.testing.assert_allclose(
        group_advantages(returns * 10, scale="none"), 10 * group_advantages(returns, scale="none")
    )


def test_a_group_weighs_by_its_learnability_and_not_by_the_inverse_of_its_spread():
    success = np.array([[1, 0, 0, 0], [1, 1, 0, 0]], dtype=bool)
    returns = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.5, 0.5]])
    advantages = group_advantages(returns, scale="learnability", success=success)
    # 8 * 3/16 = 1.5 times 3/4 and -1/4; 8 * 1/4 = 2 times 1/4 and -1/4
    np.testing.assert_array_equal(advantages, [[1.125, -0.375, -0.375, -0.375], [0.5, 0.5, -0.5, -0.5]])
    uniform = group_advantages(np.array([[0.0, 0.5]]), scale="learnability", success=np.zeros((1, 2), bool))
    assert not uniform.any()
    with pytest.raises(ValueError, match="scale_advantage='learnability'"):
        group_advantages(returns, scale="learnability")


def test_a_lone_rollout_is_refused():
    with pytest.raises(ValueError, match="K >= 2"):
        group_advantages(np.zeros((3, 1)))


def test_filter_reads_success_and_not_return():
    success = np.array([[0, 0, 0], [1, 1, 1], [1, 0, 1]], dtype=bool)
    returns = np.array([[0.0, 0.25, 0.5], [1.0, 1.0, 1.0], [1.0, 0.0, 1.0]])
    assert frontier_mask(success, returns).tolist() == [False, False, True]
    assert frontier_mask(success, returns, group_filter="mixed_return").tolist() == [True, False, True]
    assert frontier_mask(success, returns, group_filter="none").tolist() == [True, True, True]


def test_a_margin_keeps_no_group_for_a_lone_dissenter():
    success = np.tril(np.ones((9, 8), dtype=bool), k=-1)  # 0 to 8 wins
    kept = frontier_mask(success, success.astype(float), group_filter="margin")
    assert np.flatnonzero(kept).tolist() == [2, 3, 4, 5, 6]
    assert np.flatnonzero(frontier_mask(success, success.astype(float))).tolist() == [1, 2, 3, 4, 5, 6, 7]


def test_unknown_names_list_the_valid_ones_and_the_closest():
    with pytest.raises(ValueError, match=r"Did you mean 'mixed_success'\?.*'none'"):
        frontier_mask(np.zeros((1, 2), bool), np.zeros((1, 2)), group_filter="mixed_sucess")


@pytest.mark.parametrize(
    ("ratio", "advantage", "loss"),
    [(1.0, 2.0, -2.0), (1.5, 1.0, -1.28), (0.5, 1.0, -0.5), (0.5, -1.0, 0.8), (1.5, -1.0, 1.5), (1.25, 1.0, -1.25)],
)
def test_surrogate_matches_values_worked_by_hand(ratio, advantage, loss):
    got = clipped_surrogate(
        th.tensor([np.log(ratio)]), th.zeros(1), th.tensor([advantage]), clip_low=0.2, clip_high=0.28
    )
    assert got.item() == pytest.approx(loss, abs=1e-6)


@pytest.mark.parametrize(("ratio", "advantage"), [(1.3, 1.0), (0.7, -1.0)])
def test_beyond_the_clip_range_no_gradient_pushes_further(ratio, advantage):
    log_prob = th.tensor([np.log(ratio)], requires_grad=True)
    clipped_surrogate(log_prob, th.zeros(1), th.tensor([advantage]), clip_low=0.2, clip_high=0.28).sum().backward()
    assert log_prob.grad.item() == 0.0


def test_uniform_group_contributes_no_gradient():
    advantages = th.tensor(group_advantages(np.array([[0.3, 0.3, 0.3]]))[0])
    log_prob = th.tensor([0.1, -0.2, 0.0], dtype=th.float64, requires_grad=True)
    clipped_surrogate(log_prob, th.zeros(3), advantages, clip_low=0.2, clip_high=0.28).sum().backward()
    assert (log_prob.grad == 0.0).all()
