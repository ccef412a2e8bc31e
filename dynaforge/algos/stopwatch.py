"""Wall and CPU time of the two halves of training."""

from __future__ import annotations

import time
from types import TracebackType

from stable_baselines3.common.logger import Logger


class Stopwatch:
    """Measures what runs inside a `with` block.

    Attributes:
        wall: Elapsed time in s.
        cpu: CPU time of this process in s, all its threads; worker processes are not in it.
    """

    wall = 0.0
    cpu = 0.0

    def __enter__(self) -> Stopwatch:
        self._start = time.perf_counter(), time.process_time()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.wall = time.perf_counter() - self._start[0]
        self.cpu = time.process_time() - self._start[1]

    def log(self, logger: Logger, what: str) -> None:
        """Record time/<what>_s and time/<what>_cpu_s."""
        logger.record(f"time/{what}_s", self.wall)
        logger.record(f"time/{what}_cpu_s", self.cpu)
