"""Statistics of columns that are too long for memory: exact moments, and quantiles of a bounded sample."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.geometry import Array

QUANTILES = (1, 10, 50, 90, 99)
MOST_KEPT = 50_000  # rows of which quantiles are taken


class Statistics:
    """Minimum, maximum, mean and standard deviation of all rows; quantiles of all, or of every k-th of many.

    Args:
        most_kept: Rows that are kept for the quantiles at most.
    """

    def __init__(self, most_kept: int = MOST_KEPT) -> None:
        self._most_kept, self._every, self._n = most_kept, 1, 0
        self._kept: list[Array] = []
        self._low: Array
        self._high: Array
        self._mean: Array
        self._squares: Array

    def add(self, column: NDArray[Any]) -> None:
        """Add rows, shape (N, ...) with N >= 1."""
        rows = np.asarray(column, dtype=np.float64).reshape(len(column), -1)
        n, low, high, mean = len(rows), rows.min(axis=0), rows.max(axis=0), rows.mean(axis=0)
        squares = ((rows - mean) ** 2).sum(axis=0)
        self._kept.append(rows[-self._n % self._every :: self._every].copy())
        if self._n:  # the squares of two parts add up, with a term for the difference of their means
            low, high = np.minimum(low, self._low), np.maximum(high, self._high)
            apart, total = mean - self._mean, self._n + n
            squares = squares + self._squares + apart**2 * self._n * n / total
            mean = self._mean + apart * n / total
        self._n, self._low, self._high, self._mean, self._squares = self._n + n, low, high, mean, squares
        while sum(map(len, self._kept)) > self._most_kept:
            self._kept = [np.concatenate(self._kept)[::2]]
            self._every *= 2

    def summary(self) -> dict[str, list[float]]:
        """Return `min`, `max`, `mean`, `std` and `q01` to `q99`, one value per component, and `count`."""
        deviation = np.sqrt(self._squares / self._n)
        found = {"min": self._low, "max": self._high, "mean": self._mean, "std": deviation}
        kept = np.concatenate(self._kept)
        found |= {f"q{q:02d}": np.percentile(kept, q, axis=0) for q in QUANTILES}
        return {name: values.tolist() for name, values in found.items()} | {"count": [self._n]}


def statistics(column: NDArray[Any]) -> dict[str, list[float]]:
    """Return the statistics of one column, shape (N, ...)."""
    found = Statistics(len(column))
    found.add(column)
    return found.summary()
