"""Generators that fail on marked conditions; workers import this file."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

from dynaforge.demos import Episode
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome, Task


@dataclass(frozen=True)
class Unmade:
    """Finds no weights where it is to act, or ends the program once it does."""

    name: str = "unmade"

    def make_env(self, task: Task) -> ResidualEnv:
        raise RuntimeError(f"no weights for {task.name}")

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        raise SystemExit(3)


@dataclass(frozen=True)
class Faulty:
    """Succeeds without simulating, but raises or kills its process on the conditions that are marked."""

    raises: frozenset[str] = frozenset()
    dies: frozenset[str] = frozenset()
    slow: frozenset[str] = frozenset()
    name: str = "faulty"

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        if condition.id in self.slow:
            time.sleep(1.0)
        if condition.id in self.dies:
            os._exit(3)
        if condition.id in self.raises:
            raise RuntimeError("the marked condition")
        outcome = Outcome(success=True, checkpoint=5, phase="lift")
        return Episode(condition=condition, generator=self.name, outcome=outcome, duration=1.0, steps={})
