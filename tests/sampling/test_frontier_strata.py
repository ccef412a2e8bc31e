"""Strata drawn in proportion to what can be learned on them."""

from __future__ import annotations

import numpy as np
import pytest

from dynaforge.sampling.frontier_strata import LONGEST_WAIT, MEMORY, MOST, StratumRecord, capped_shares


def record_of(rates: list[float], n: int = 40) -> StratumRecord:
    wins = n * np.array(rates)
    return StratumRecord(wins, n - wins, np.zeros(len(rates)))


def test_a_record_that_is_empty_draws_every_stratum_once():
    for seed in range(20):
        assert StratumRecord.empty(16).draw(np.random.default_rng(seed)) == list(range(16))


def test_learnability_matches_values_worked_by_hand():
    # E[p (1 - p)] under Beta(a, b) is ab / ((a + b)(a + b + 1)): 1/6 unseen, 9 * 1 / (10 * 11) after 8 of 8
    record = StratumRecord(np.array([0.0, 8.0, 4.0, 0.0]), np.array([0.0, 0.0, 4.0, 8.0]), np.zeros(4))
    np.testing.assert_allclose(record.learnability, [1 / 6, 9 / 110, 25 / 110, 9 / 110])
    np.testing.assert_array_equal(record.success, [np.nan, 1.0, 0.5, 0.0])


def test_strata_are_drawn_in_proportion_to_their_learnability_and_n_of_them():
    record = record_of([1.0, 0.9, 0.5, 0.0])
    expected = capped_shares(record.learnability, 4, MOST)
    rng = np.random.default_rng(0)
    drawn = [record.draw(rng) for _ in range(2000)]
    assert {len(strata) for strata in drawn} == {4}
    assert all(strata == sorted(strata) for strata in drawn)
    counts = np.array([np.bincount(strata, minlength=4) for strata in drawn])
    np.testing.assert_allclose(counts.mean(axis=0), expected, atol=0.03)
    assert (np.abs(counts - expected) < 1).all(), "a share is only rounded down or up"


@pytest.mark.parametrize("rates", [[0.5, *[1.0] * 15], [0.5] * 3 + [0.0] * 13])
def test_no_stratum_takes_more_than_its_cap_however_little_the_others_teach(rates):
    rng = np.random.default_rng(0)
    counts = np.bincount(record_of(rates, n=4000).draw(rng), minlength=16)
    assert counts.sum() == 16
    assert counts.max() == MOST


def test_what_a_cap_cuts_off_goes_to_the_others_in_proportion():
    np.testing.assert_allclose(capped_shares(np.array([6.0, 1.0, 1.0]), 4, 2), [2, 1, 1])
    np.testing.assert_allclose(capped_shares(np.array([9.0, 4.0, 1.0, 1.0]), 6, 2), [2, 2, 1, 1])
    np.testing.assert_allclose(capped_shares(np.ones(4), 8, 2), [2, 2, 2, 2])


def test_every_stratum_is_drawn_within_a_few_updates():
    record, rng = StratumRecord.empty(16), np.random.default_rng(0)
    last = np.zeros(16)
    for update in range(1, 101):
        strata = record.draw(rng)
        assert len(strata) == 16
        last[strata] = update
        assert (update - last).max() < LONGEST_WAIT
        # Half of the strata are mastered for good, the others always teach.
        success = np.array([[True] * 8 if stratum < 8 else [True, False] * 4 for stratum in strata])
        record = record.after(strata, success)


def test_a_record_counts_own_trials_only_and_fades():
    record = StratumRecord.empty(3).after([2, 2, 0], [[1, 1], [1, 0], [0, 0]])
    np.testing.assert_allclose(record.wins, [0, 0, 3])
    np.testing.assert_allclose(record.losses, [2, 0, 1])
    np.testing.assert_allclose(record.waits, [0, 1, 0])
    faded = record.after([1], None)
    np.testing.assert_allclose(faded.wins, MEMORY * record.wins)
    np.testing.assert_allclose(faded.waits, [1, 0, 1])
    np.testing.assert_allclose(faded.success[[0, 2]], record.success[[0, 2]])
