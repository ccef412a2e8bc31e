"""RRT-Connect in joint space, and shortcutting of what it finds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dynaforge.geometry import Array

EdgeFree = Callable[[Array, Array], bool]


class _Tree:
    """Configurations, each reached from an earlier one by a free edge."""

    def __init__(self, root: Array, capacity: int) -> None:
        self._nodes = np.empty((capacity, len(root)))
        self._nodes[0] = root
        self._parents = [-1]

    def nearest(self, q: Array) -> int:
        difference = self._nodes[: len(self._parents)] - q
        return int(np.argmin(np.einsum("ij,ij->i", difference, difference)))

    def add(self, q: Array, parent: int) -> int:
        if len(self._parents) == len(self._nodes):
            self._nodes = np.concatenate((self._nodes, np.empty_like(self._nodes)))
        self._nodes[len(self._parents)] = q
        self._parents.append(parent)
        return len(self._parents) - 1

    def node(self, index: int) -> Array:
        q: Array = self._nodes[index].copy()
        return q

    def branch(self, index: int) -> list[Array]:
        """Return the configurations from this node back to the root."""
        path = []
        while index >= 0:
            path.append(self.node(index))
            index = self._parents[index]
        return path


def rrt_connect(
    start: Array,
    goal: Array,
    *,
    edge_free: EdgeFree,
    lower: Array,
    upper: Array,
    rng: np.random.Generator,
    step: float = 0.5,
    max_samples: int = 1000,
) -> list[Array] | None:
    """Join start and goal by free straight edges (Kuffner and LaValle, 2000).

    Two trees grow in turn: one makes a step toward a random configuration, then the other grows toward the new node
    until it arrives or is blocked.

    Args:
        start: A free configuration, radians, shape (n,).
        goal: Another free configuration, radians, shape (n,).
        edge_free: Whether the straight edge between two configurations is free.
        lower: Lower bounds of the random configurations, radians, shape (n,).
        upper: Upper bounds of the random configurations, radians, shape (n,).
        rng: Draws the random configurations.
        step: Length of the longest edge, radians (Euclidean).
        max_samples: Largest number of random configurations.

    Returns:
        Waypoints from start to goal, or None if the samples ran out.
    """
    tree, other = _Tree(start, 128), _Tree(goal, 128)
    from_start = True
    for _ in range(max_samples):
        node = _extend(tree, rng.uniform(lower, upper), edge_free, step)
        if node is not None:
            target = tree.node(node)
            meeting = _connect(other, target, edge_free, step)
            if meeting is not None:
                ours, theirs = tree.branch(node), other.branch(meeting)
                path = ours[::-1] + theirs[1:]
                return path if from_start else path[::-1]
        tree, other, from_start = other, tree, not from_start
    return None


def shortcut(path: list[Array], *, edge_free: EdgeFree, rng: np.random.Generator, attempts: int = 60) -> list[Array]:
    """Replace parts of a path by straight edges where these are free.

    Args:
        path: Waypoints, radians, shape (n,) each.
        edge_free: Whether the straight edge between two configurations is free.
        rng: Draws the two points on the path that an attempt joins.
        attempts: Number of pairs tried.

    Returns:
        A path with the same ends that is no longer.
    """
    path = list(path)
    for _ in range(attempts):
        if len(path) < 3:
            break
        (i, a), (j, b) = sorted(_draw(path, rng) for _ in range(2))
        if i == j:
            continue
        first = (1.0 - a) * path[i] + a * path[i + 1]  # this form hits both ends exactly
        second = (1.0 - b) * path[j] + b * path[j + 1]
        if edge_free(first, second):
            path[i + 1 : j + 1] = [first, second]
    return _without_repeats(path)


def _draw(path: list[Array], rng: np.random.Generator) -> tuple[int, float]:
    """Draw a point on the path as (edge, share of the edge): a waypoint half of the time, otherwise any point."""
    edge = int(rng.integers(len(path) - 1))
    return edge, float(rng.choice((0.0, 1.0))) if rng.random() < 0.5 else float(rng.random())


def _without_repeats(path: list[Array]) -> list[Array]:
    kept = [path[0]]
    for q in path[1:]:
        if float(np.abs(q - kept[-1]).max()) > 1e-9:
            kept.append(q)
    kept[-1] = path[-1]  # of coinciding points, the last one kept must be exactly the goal
    return kept


def _extend(tree: _Tree, toward: Array, edge_free: EdgeFree, step: float) -> int | None:
    index = tree.nearest(toward)
    near = tree.node(index)
    distance = float(np.linalg.norm(toward - near))
    q = toward if distance <= step else near + (toward - near) * (step / distance)
    return tree.add(q, index) if edge_free(near, q) else None


def _connect(tree: _Tree, target: Array, edge_free: EdgeFree, step: float) -> int | None:
    index = tree.nearest(target)
    while True:
        near = tree.node(index)
        distance = float(np.linalg.norm(target - near))
        if distance <= 1e-12:
            return index
        q = target if distance <= step else near + (target - near) * (step / distance)
        if not edge_free(near, q):
            return None
        index = tree.add(q, index)
