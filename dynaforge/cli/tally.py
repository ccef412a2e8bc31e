"""A progress bar of attempts."""

from __future__ import annotations

from collections import Counter
from typing import Any

from tqdm import tqdm

from dynaforge.demos import Attempt
from dynaforge.generators import Goal
from dynaforge.generators.giving_up import describe_counts


class Tally:
    """Counts attempts and shows a bar with the successes and the commonest reasons of failures.

    Args:
        goal: The goal of collecting, from which the bar takes its length.
        leave: Whether the bar stays on the screen at the end.
    """

    def __init__(self, goal: Goal, *, leave: bool = True) -> None:
        self.successes = self.attempts = 0
        self.reasons: Counter[str] = Counter()
        self._counts_demos = goal.demos is not None
        # miniters 0, since a failed attempt does not advance a bar of demonstrations but changes its text
        self._bar: tqdm[Any] = tqdm(
            total=goal.demos or goal.attempts,
            unit="demo" if self._counts_demos else "attempt",
            leave=leave,
            smoothing=0.05,
            miniters=0,
            mininterval=0.5,
        )

    def __enter__(self) -> Tally:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def __str__(self) -> str:
        return f"{self.successes} successes in {self.attempts} attempts"

    @property
    def rate(self) -> float:
        """Successes over attempts."""
        return self.successes / max(self.attempts, 1)

    def add(self, attempt: Attempt) -> None:
        """Count an attempt."""
        self.successes, self.attempts = self.successes + attempt.success, self.attempts + 1
        if not attempt.success:
            self.reasons[attempt.failure] += 1
        failed = f"; failed: {describe_counts(self.reasons, n=2, longest=40)}" if self.reasons else ""
        self._bar.set_postfix_str(f"DGR {self.rate:.0%} of {self.attempts}{failed}", refresh=False)
        self._bar.update(int(attempt.success) if self._counts_demos else 1)
