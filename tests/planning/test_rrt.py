from __future__ import annotations

from itertools import pairwise

import numpy as np

from dynaforge.geometry import Array
from dynaforge.planning.rrt import rrt_connect, shortcut

LOWER, UPPER = np.zeros(2), np.ones(2)
START, GOAL = np.array((0.1, 0.1)), np.array((0.9, 0.1))


def edge_free(a: Array, b: Array) -> bool:
    """A wall at x = 0.5 that is open above y = 0.8."""
    points = a + np.linspace(0.0, 1.0, 101)[:, None] * (b - a)
    return not bool(((np.abs(points[:, 0] - 0.5) < 0.05) & (points[:, 1] < 0.8)).any())


def solve(seed: int) -> list[Array]:
    path = rrt_connect(
        START, GOAL, edge_free=edge_free, lower=LOWER, upper=UPPER, rng=np.random.default_rng(seed), step=0.2
    )
    assert path is not None
    return path


def length(path: list[Array]) -> float:
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(path)))


def test_paths_lead_from_start_to_goal_along_free_edges() -> None:
    for seed in range(20):
        path = solve(seed)
        np.testing.assert_array_equal(path[0], START)
        np.testing.assert_array_equal(path[-1], GOAL)
        assert all(edge_free(a, b) for a, b in pairwise(path))


def test_shortcuts_keep_the_ends_stay_free_and_never_lengthen() -> None:
    gains = []
    for seed in range(20):
        path = solve(seed)
        shorter = shortcut(path, edge_free=edge_free, rng=np.random.default_rng(seed))
        np.testing.assert_array_equal(shorter[0], START)
        np.testing.assert_array_equal(shorter[-1], GOAL)
        assert all(edge_free(a, b) for a, b in pairwise(shorter))
        assert length(shorter) <= length(path) + 1e-12
        gains.append(length(shorter) / length(path))
    assert np.mean(gains) < 0.9


def test_a_closed_wall_gives_no_path() -> None:
    def closed(a: Array, b: Array) -> bool:
        return bool((a[0] < 0.5) == (b[0] < 0.5))

    rng = np.random.default_rng(0)
    assert rrt_connect(START, GOAL, edge_free=closed, lower=LOWER, upper=UPPER, rng=rng, max_samples=50) is None
