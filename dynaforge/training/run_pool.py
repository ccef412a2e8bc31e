"""Several training runs at a time, on the cores of this machine or anywhere else, with one progress bar."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from tqdm import tqdm

from dynaforge.training.run_spec import RunSpec

LONGEST_WAIT = 5.0  # seconds between two looks at the deadline

News = tuple[RunSpec, dict[str, Any] | str]
"""A run, and its progress as `run.report_progress` told it; or why it failed, "" if it is finished."""


class Runs(Protocol):
    """Runs that are made somewhere, a limited number at a time."""

    @property
    def left(self) -> int:
        """Number of runs that have not ended."""

    def news(self, seconds: float) -> list[News]:
        """Wait until there is news of a run, but not longer than this; a run that has ended makes room for the next."""

    def stop(self) -> None:
        """End the runs in progress; what those that are finished have stored stays."""


class RunPool:
    """Makes runs, with a progress bar.

    Args:
        specs: The runs.
        runs: The same runs, where they are made.
        seconds: Wall time after which they are stopped; what they have stored stays.
    """

    def __init__(self, specs: Sequence[RunSpec], runs: Runs, *, seconds: float) -> None:
        self._specs, self._runs = specs, runs
        self._deadline = time.monotonic() + seconds
        self._steps: dict[Path, int] = {}
        self._texts: dict[Path, str] = {}
        self._failures: list[str] = []

    def work(self) -> bool:
        """Make the runs.

        Returns:
            Whether all of them were finished; False when time ran out, at Ctrl-C, or when a run failed.
        """
        total = sum(spec.steps for spec in self._specs)
        with tqdm(total=total, unit="step", unit_scale=True, smoothing=0.02, dynamic_ncols=True, mininterval=1) as bar:
            try:
                while self._runs.left:
                    news = self._runs.news(min(LONGEST_WAIT, max(0.0, self._deadline - time.monotonic())))
                    if not news and time.monotonic() >= self._deadline:
                        return False
                    for spec, what in news:
                        self._show(spec, what, bar)
                    finished = len(self._specs) - self._runs.left - len(self._failures)
                    bar.set_description_str(f"{finished} of {len(self._specs)} runs", refresh=False)
                    bar.set_postfix_str(" | ".join(self._texts.values()), refresh=False)
                    bar.update(0)
            except KeyboardInterrupt:
                return False
            finally:
                self._runs.stop()
        for line in self._failures:
            print(line, file=sys.stderr)
        return not self._failures

    def _show(self, spec: RunSpec, what: dict[str, Any] | str, bar: Any) -> None:
        if isinstance(what, dict):
            self._count(spec, what.get("steps", self._steps.get(spec.folder, 0)), bar)
            self._texts[spec.folder] = f"{Path(spec.task).stem}/{spec.variant}/{spec.seed} {what['text']}"
            return
        self._texts.pop(spec.folder, None)
        if what:
            self._failures.append(f"{spec.folder} failed{what}")
            bar.write(self._failures[-1])
        else:
            self._count(spec, spec.steps, bar)

    def _count(self, spec: RunSpec, steps: int, bar: Any) -> None:
        bar.update(steps - self._steps.get(spec.folder, 0))
        self._steps[spec.folder] = steps
