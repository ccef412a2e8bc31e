"""A dataset in plain text: rates of its attempts; lengths, ranges and coverage of its recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dynaforge.demos import Attempt, Episode
from dynaforge.evaluation.dgr_tables import describe_forces
from dynaforge.reports.evaluation import by_generator, reports_of
from dynaforge.tasks import Task
from dynaforge.tasks.action import ActionLayout
from dynaforge.training.sparkline import sparkline

PARTS = 16  # equal parts of a field's range
RESIDUALS = ("x", "y", "z", "rotation x", "rotation y", "rotation z", "width")


def attempt_tables(attempts: Sequence[Attempt], task: Task) -> Iterator[str]:
    """Yield the rates of each generator, how hard its successes press, and how long its attempts took."""
    grouped = by_generator(attempts)
    for report in reports_of(task, grouped):
        lines = report.table(), describe_forces(report), _wall_time(grouped[report.label])
        yield "\n".join(line for line in lines if line)


def recording_summary(episodes: Sequence[Episode], task: Task) -> str:
    """Return lengths, actions, residuals and coverage of one or more recordings, as text."""
    return "\n".join([_lengths(episodes), _actions(episodes), _residuals(episodes), _coverage(episodes, task)])


def _lengths(episodes: Sequence[Episode]) -> str:
    """Return how long the recordings are."""
    steps, seconds = [len(e) for e in episodes], [e.duration for e in episodes]
    return (
        f"length: {np.median(steps):.0f} control steps ({min(steps)} to {max(steps)}), "
        f"{np.median(seconds):.1f} s ({min(seconds):.1f} to {max(seconds):.1f}); {sum(steps)} steps in all"
    )


def _actions(episodes: Sequence[Episode]) -> str:
    """Return the range of each component of the targets that the controller was given."""
    given = [e.steps["projected_action"] for e in episodes if "projected_action" in e.steps]
    if not given:
        return "actions: none recorded"
    rows = np.concatenate(given)
    lines = [
        f"  {name:<11} {low:+.3f} to {high:+.3f}"
        for name, low, high in zip(ActionLayout().names, rows.min(axis=0), rows.max(axis=0), strict=False)
    ]
    return "actions, target pose in the base frame and width (m):\n" + "\n".join(lines)


def _residuals(episodes: Sequence[Episode]) -> str:
    """Return how far the residual moved the target while its gate was open."""
    gated = [
        e.steps["residual_action"][e.steps["gate"]]
        for e in episodes
        if "residual_action" in e.steps and "gate" in e.steps
    ]
    if not gated or not sum(map(len, gated)):
        return "residual: none recorded"
    rows = np.concatenate(gated)
    quantiles = np.quantile(rows, (0.01, 0.5, 0.99), axis=0).T
    lines = [
        f"  {name:<11} {low:+.3f} {middle:+.3f} {high:+.3f}"
        for name, (low, middle, high) in zip(RESIDUALS, quantiles.tolist(), strict=False)
    ]
    return "residual while gated (m, rad, m), 1 %, 50 % and 99 % quantile:\n" + "\n".join(lines)


def _coverage(episodes: Sequence[Episode], task: Task) -> str:
    """Return how evenly the recordings cover the range of each field of the condition."""
    lines = []
    for name, (low, high) in task.conditions.ranges.items():
        values = [
            e.condition.values[name] for e in episodes if name in e.condition.values
        ]  # a file from elsewhere may lack it
        counts, _ = np.histogram(values, bins=PARTS, range=(low, high))
        bars = sparkline(count / counts.max() if count else np.nan for count in counts.tolist())
        lines.append(f"  {name:<11} {low:>8.4g} {bars} {high:<8.4g} {np.count_nonzero(counts)} of {PARTS} parts")
    return f"recordings over the range of each field of the condition, in {PARTS} equal parts:\n" + "\n".join(lines)


def _wall_time(attempts: Sequence[Attempt]) -> str:
    timed = [attempt.wall_seconds for attempt in attempts if attempt.wall_seconds]
    return f"an attempt took {np.median(timed):.2f} s on one core" if timed else ""
