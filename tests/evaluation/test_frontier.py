from __future__ import annotations

import numpy as np
import pytest

from dynaforge.evaluation import analyse_frontier, wilson_interval
from dynaforge.evaluation.frontier import trailing_mean


def test_frontier_of_a_hand_made_run():
    # K = 8. Stratum 2 is easiest, 0 next, 1 never succeeds. 8/8 has the lower bound .676, 6/8 .409.
    successes = np.array([[0, 0, 8], [6, 0, 8], [8, 0, 8], [8, 0, 8]])
    result = analyse_frontier(successes, 8, window=2, smoothing=2)
    assert result.order.tolist() == [2, 0, 1]
    # pooled over two updates, stratum 0: 0/8, 6/16, 14/16, 16/16
    assert result.depth.tolist() == [1, 1, 2, 2]
    np.testing.assert_allclose(result.frontier, [1.0, 1.0, 1.5, 2.0])
    np.testing.assert_allclose(result.trailing[:, 0], [0.0, 0.375, 0.875, 1.0])
    np.testing.assert_allclose(result.overall, [1 / 3, 14 / 24, 2 / 3, 2 / 3])


def test_frontier_is_contiguous():
    # the hard strata are mastered at the end while the one ranked first has collapsed
    successes = np.array([[8, 0, 0]] * 30 + [[0, 8, 0]] * 20)
    result = analyse_frontier(successes, 8)
    assert result.order[0] == 0
    assert result.depth[29] == 1
    assert result.depth[-1] == 0


def test_the_bound_is_the_wilson_bound_of_the_pooled_window():
    # 6/8 stays at .75 while trials pool: lower bound .409 at 6/8, .505 at 12/16
    assert wilson_interval(6, 8).low == pytest.approx(0.4093, abs=1e-4)
    assert wilson_interval(12, 16).low == pytest.approx(0.5050, abs=1e-4)
    assert analyse_frontier([[6], [6]], 8, window=2).depth.tolist() == [0, 1]
    assert analyse_frontier([[6], [6]], 8, window=1).depth.tolist() == [0, 0]


def test_trailing_window_is_eq_10():
    values = np.arange(1.0, 31.0)
    result = trailing_mean(values, 20)
    assert result[0] == 1.0
    assert result[9] == pytest.approx(5.5)
    assert result[29] == pytest.approx(np.mean(values[10:]))


def test_overall_success_is_that_of_all_outcomes():
    outcomes = np.random.default_rng(0).random((40, 5, 8)) < np.linspace(0.9, 0.2, 5)[None, :, None]
    one = analyse_frontier(outcomes.sum(2), 8)
    np.testing.assert_allclose(one.overall, outcomes.mean((1, 2)))
    np.testing.assert_allclose(one.overall_trailing[-1], outcomes[-20:].mean())


def test_strata_without_trials_are_unknown_and_not_mastered():
    result = analyse_frontier([[8, 0], [8, 0]], [[8, 0], [8, 0]])
    assert np.isnan(result.success[:, 1]).all()
    assert result.depth.tolist() == [1, 1]
    np.testing.assert_allclose(result.overall, [1.0, 1.0])


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match=r"\(U, N\)"):
        analyse_frontier(np.zeros(3), 8)
    with pytest.raises(ValueError, match="between 0 and"):
        analyse_frontier([[9]], 8)


def test_a_curve_does_not_depend_on_how_often_a_stratum_is_drawn():
    # The easy stratum always succeeds, the hard one half the time; the curriculum soon draws the hard one alone.
    every = analyse_frontier([[8, 4]] * 6, 8)
    mostly_hard = analyse_frontier([[8, 4], [0, 8], [0, 8], [8, 4], [0, 8], [0, 8]], [[8, 8], [0, 16], [0, 16]] * 2)
    np.testing.assert_allclose(mostly_hard.overall, every.overall)
    np.testing.assert_allclose(mostly_hard.overall_trailing, every.overall_trailing)
    assert mostly_hard.success[1, 1] == 0.5
    late = analyse_frontier([[8, 0], [0, 4]], [[8, 0], [0, 8]])
    np.testing.assert_allclose(late.overall, [1.0, 0.75])
