"""How hard demonstrations press, and which settings of the reflex would have stopped them, as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from dynaforge.demos import Attempt
from dynaforge.sim.loads import Loads
from dynaforge.sim.reflex import named_within, thresholds
from dynaforge.sim.setting import Reflex
from dynaforge.tasks import Task


def describe_reflex(reflex: Reflex) -> str:
    """Return what the robot bears before it stops, in one sentence."""
    if reflex == "off":
        return "off: no force stops the robot"
    bounds = thresholds(reflex)
    low, high = bounds.torque.min(), bounds.torque.max()
    torque = f"{low:g} Nm" if low == high else f"{low:g} to {high:g} Nm"
    name = f"{reflex}: " if isinstance(reflex, str) else ""
    return (
        f"{name}above {bounds.force:g} N or {bounds.moment:g} Nm on the hand, or {torque} at a joint, for two control "
        "steps in a row, the robot stops"
    )


def describe_peaks(loads: Sequence[Loads | None], reflex: Reflex) -> str:
    """Return the distribution of the peak forces of demonstrations, and how many of them stricter reflexes would stop.

    Args:
        loads: The greatest loads of each demonstration; None where they are not known.
        reflex: The reflex under which they were made.
    """
    known = [load for load in loads if load is not None]
    if not known:
        return "not recorded"
    substep, steps = ([getattr(load, name) for load in known] for name in ("peak_force", "force"))
    stopped = ", ".join(
        f"{name} would stop {sum(name in tripped(load, reflex) for load in known)} of {len(known)}"
        for name in named_within(reflex)
    )
    spread = f"{_spread(substep)} in a substep; {_spread(steps)} as the mean of two control steps"
    unknown = len(loads) - len(known)
    return "; ".join([spread, *([stopped] if stopped else []), *([f"not recorded in {unknown}"] if unknown else [])])


def tripped(load: Loads, reflex: Reflex) -> tuple[str, ...]:
    """Return the named thresholds that loads exceed, of those that an attempt under a reflex tells."""
    return tuple(name for name in named_within(reflex) if getattr(load, name) > 1.0)


def force_lines(attempts: Iterable[Attempt], task: Task) -> list[str]:
    """Return one line for each demonstration, those that press hardest first, and a summary at the end.

    Args:
        attempts: The demonstrations.
        task: Their task, in its setting.
    """
    found, reflex = list(attempts), task.setting.reflex
    if not found:
        return []
    lines = []
    for attempt in sorted(found, key=lambda a: -1.0 if a.loads is None else a.loads.peak_force, reverse=True):
        load = attempt.loads
        if load is None:
            lines.append(f"  {attempt.id}: not recorded")
            continue
        names = ", ".join(tripped(load, reflex)) or "none"
        lines.append(f"  {attempt.id}: {load.peak_force:5.1f} N, {load.force:5.1f} N; exceeds {names}")
    told = ", ".join(named_within(reflex)) or "none that is named"
    return [
        f"reflex {describe_reflex(reflex)}",
        f"peak force of each demonstration: in a substep; mean of two control steps; what it exceeds of {told}",
        *lines,
        f"{len(found)} demonstrations: {describe_peaks([attempt.loads for attempt in found], reflex)}",
    ]


def _spread(newtons: Sequence[float]) -> str:
    p50, p90 = np.percentile(newtons, (50, 90)).tolist()
    return f"median {p50:.0f} N, 90 % {p90:.0f} N, greatest {max(newtons):.0f} N"
