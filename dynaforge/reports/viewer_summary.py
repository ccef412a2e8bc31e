"""The numbers of the page's summary: success by difficulty and by generator, lengths, and why attempts failed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from dynaforge.demos import Attempt
from dynaforge.evaluation.dgr import Count, failure_counts
from dynaforge.reports.evaluation import by_generator
from dynaforge.tasks import Task

STRATA = 8
LENGTHS = 16  # bars of the histogram


def strata(task: Task) -> list[str]:
    """Return the names of the bins of difficulty, e.g. "0.2 to 0.3 m/s"."""
    edges = np.linspace(*task.conditions.difficulty_range, STRATA + 1).tolist()
    unit = task.conditions.units.get(task.conditions.difficulty, "")
    return [f"{low:.3g} to {high:.3g} {unit}".rstrip() for low, high in itertools.pairwise(edges)]


def summarise(task: Task, attempts: Sequence[Attempt]) -> dict[str, Any]:
    """Count attempts, as plain JSON data.

    Args:
        task: The task.
        attempts: All attempts of the dataset.

    Returns:
        `bins` and `generators`: (name, n, successes, low, high), where low and high are the Wilson 95 % interval;
        `lengths`: the longest attempt in seconds, and the numbers of successes and failures in each of `LENGTHS` equal
        parts up to it; `failures`: (reason, count), the most frequent first.
    """
    parts: list[list[Attempt]] = [[] for _ in range(STRATA)]
    for attempt in attempts:
        parts[task.conditions.stratum(attempt.difficulty, STRATA)].append(attempt)
    return {
        "bins": [_counted(name, part) for name, part in zip(strata(task), parts, strict=True)],
        "generators": [_counted(name, made) for name, made in by_generator(attempts).items()],
        "lengths": _lengths(attempts),
        "failures": list(failure_counts(attempts).items()),
    }


def _counted(name: str, attempts: Sequence[Attempt]) -> list[Any]:
    count = Count(sum(attempt.success for attempt in attempts), len(attempts))
    low, high = count.interval if count.n else (0.0, 1.0)
    return [name, count.n, count.successes, round(low, 4), round(high, 4)]


def _lengths(attempts: Sequence[Attempt]) -> dict[str, Any]:
    """Return the histogram of lengths; an attempt that never began has none."""
    longest = max((attempt.duration for attempt in attempts), default=0.0)
    counts = {}
    for name, wanted in (("successes", True), ("failures", False)):
        lengths = [a.duration for a in attempts if a.success is wanted and a.duration > 0]
        counts[name] = np.histogram(lengths, bins=LENGTHS, range=(0.0, longest or 1.0))[0].tolist()
    return {"longest": round(longest, 2), **counts}
