"""The paper's first table: rates of generators on tasks, their means, which are best, what one gains over another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, pstdev

from dynaforge.evaluation.dgr import DgrReport


@dataclass(frozen=True, slots=True)
class Rate:
    """A rate and how far it spreads over the blocks of conditions.

    Attributes:
        mean: Mean over the blocks.
        std: Their standard deviation as the paper gives it, with the number of blocks in the denominator: its 42.67 and
            5.44 come from three whole numbers of 100 in no other way.
    """

    mean: float
    std: float

    @staticmethod
    def of(blocks: Sequence[float]) -> Rate:
        """Return the rate of which each block has these."""
        return Rate(mean(blocks), pstdev(blocks))

    @property
    def shown(self) -> float:
        """The mean as a table shows it, a percentage with two digits: what is equal there counts as equal."""
        return round(100.0 * self.mean, 2)


@dataclass(frozen=True, slots=True)
class RateTable:
    """Rates by generator and task.

    Attributes:
        tasks: The tasks, in the order of the columns.
        reports: Row to task to what was measured; a task that is missing was not, because the generator does not
            support it or because it has not come to it yet.
    """

    tasks: Sequence[str]
    reports: Mapping[str, Mapping[str, DgrReport]]

    def rate(self, row: str, task: str) -> Rate | None:
        """Return the rate of a generator on a task; None where it was not measured."""
        report = self.reports[row].get(task)
        return None if report is None else Rate.of([block.rate for block in report.blocks])

    def mean(self, row: str) -> Rate | None:
        """Return the mean over the tasks that a generator was measured on, with the spread of the blocks' means.

        A block's mean is that of its rates on all these tasks. So the means of generators with different tasks are not
        of the same thing; the paper gives them nevertheless, and so does this.
        """
        measured = [report for task in self.tasks if (report := self.reports[row].get(task)) is not None]
        if not measured:
            return None
        whole = min(len(report.blocks) for report in measured)  # a comparison that ended early has fewer blocks
        if whole < max(len(report.blocks) for report in measured):
            return Rate.of([mean(report.mean for report in measured)])
        return Rate.of([mean(report.blocks[k].rate for report in measured) for k in range(whole)])

    def best(self, task: str | None, place: int = 0) -> tuple[str, ...]:
        """Return the rows with the best rate on a task, or by the mean; several where they are equal as shown.

        Args:
            task: The task; None for the mean.
            place: 0 for the best, 1 for the second best and so on.
        """
        rates = {row: self.mean(row) if task is None else self.rate(row, task) for row in self.reports}
        shown = {row: rate.shown for row, rate in rates.items() if rate is not None}
        values = sorted(set(shown.values()), reverse=True)
        return tuple(row for row in shown if len(values) > place and shown[row] == values[place])

    def gain(self, row: str, over: str, task: str | None) -> float | None:
        """Return by how many percentage points a generator's rate exceeds another's; None where one has none.

        It is the difference of the two numbers that the table shows, as the paper defines it.

        Args:
            row: The generator.
            over: The other one.
            task: The task; None for the mean, which is compared only where both have the same tasks.
        """
        if task is None and set(self.reports[row]) != set(self.reports[over]):
            return None
        first, second = (self.mean(name) if task is None else self.rate(name, task) for name in (row, over))
        return None if first is None or second is None else round(first.shown - second.shown, 2)
