"""What demonstrations cost: the paper's model, which assumes that attempts cost the same, and measured CPU-hours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from dynaforge.evaluation.dgr import Count
from dynaforge.evaluation.paper import PAPER_DGR
from dynaforge.evaluation.statistics import Interval

PAPER_TASKS = ("can", "bottle", "toycar", "peach", "block")
"""The tasks of the paper's second table: those that all of its generators support."""

REFERENCE = "residual"
"""The generator whose collection the paper's model takes as its unit."""

COLLECTION_HOURS = 4.0  # of the reference, all tasks together
TRAINING_HOURS = 2.5  # of the reference's residual policies, all tasks together

PAPER_HUMAN_MINUTES: Mapping[str, float] = MappingProxyType(
    {
        "state_machine": len(PAPER_TASKS) * (10.0 + 10.0),  # setup and debugging
        "dmp": len(PAPER_TASKS) * (10.0 + 0.5),  # setup and one demonstration by hand
        "planner_only": len(PAPER_TASKS) * (10.0 + 5.0),  # setup and debugging
        "residual": len(PAPER_TASKS) * 10.0,  # setup
    }
)
"""The minutes of human work that the paper budgets for its tasks together; assumed there, and not measured here."""


def model_hours(
    rates: Mapping[str, Sequence[float]],
    *,
    reference: str = REFERENCE,
    collection: float = COLLECTION_HOURS,
    training: float = TRAINING_HOURS,
) -> dict[str, float]:
    """Return the machine time of each generator under the paper's cost model, hours.

    Every attempt is assumed to cost the same, so collection takes time in proportion to the attempts that a success
    needs, summed over the tasks: T_g = T_ref * sum_k(1 / DGR_gk) / sum_k(1 / DGR_ref,k). The reference's training is
    added to its collection; the other generators need no other machine time. Setup is left out.

    Args:
        rates: DGR in (0, 1] of each generator on each task, the same tasks in the same order.
        reference: The generator whose collection takes `collection` hours.
        collection: Hours of the reference's collection, all tasks together.
        training: Hours of the reference's training, all tasks together.

    Returns:
        Hours by generator; infinite where a generator never succeeds on a task.

    Raises:
        ValueError: The reference is missing or never succeeds on a task, generators have different numbers of tasks, or
            a rate is not in [0, 1].
    """
    if reference not in rates:
        raise ValueError(f"The cost model needs the rates of {reference!r}; given are {', '.join(rates) or 'none'}.")
    if len({len(row) for row in rates.values()}) > 1 or not rates[reference]:
        raise ValueError("The cost model needs the rates of all generators on the same tasks, one at least.")
    if any(not 0.0 <= rate <= 1.0 for row in rates.values() for rate in row):
        raise ValueError("A rate must be between 0 and 1.")
    attempts = {name: sum(1.0 / rate if rate else math.inf for rate in row) for name, row in rates.items()}
    if math.isinf(attempts[reference]):
        raise ValueError(f"The cost model is scaled by {reference!r}, which never succeeds on one of the tasks.")
    hours = {name: collection * needed / attempts[reference] for name, needed in attempts.items()}
    return hours | {reference: hours[reference] + training}


def paper_hours() -> dict[str, float]:
    """Return the machine time in the paper's second table, computed from the DGR in its first, hours by generator."""
    rates = {
        name: [cell[0] / 100.0 for task in PAPER_TASKS if (cell := row[task]) is not None]
        for name, row in PAPER_DGR.items()
    }
    return model_hours(rates)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a number of successes of one generator on one task costs, as measured.

    Attributes:
        count: Successes among the attempts that were measured.
        seconds: CPU-seconds of an attempt, mean over all attempts, failed ones included.
        demos: Number of successes that are wanted.
        preparation: CPU-hours before the first attempt: training, or the recording of a source demonstration.
    """

    count: Count
    seconds: float
    demos: int = 800
    preparation: float = 0.0

    @property
    def attempts(self) -> float:
        """Attempts expected until so many succeed, `demos` / DGR; infinite if none did."""
        return self.demos / self.count.rate if self.count.successes else math.inf

    @property
    def attempts_interval(self) -> Interval:
        """The attempts that the ends of the DGR's Wilson 95 % interval give; the upper end may be infinite."""
        low, high = self.count.interval
        return Interval(self.demos / high, self.demos / low if self.count.successes else math.inf)

    @property
    def collection(self) -> float:
        """CPU-hours expected for collecting; infinite if no attempt succeeded."""
        return self.attempts * self.seconds / 3600.0

    @property
    def total(self) -> float:
        """CPU-hours of preparation and collection together; infinite if no attempt succeeded."""
        return self.preparation + self.collection
