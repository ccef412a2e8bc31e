"""How late sensors and commands are, in whole control steps: drawn by the condition where sensing is real."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

import numpy as np

from dynaforge.sim.condition import Condition

MOST_SENSING_DELAY = 2  # control steps
MOST_ACTION_DELAY = 1  # control steps
_STREAM = 0x64656C61  # keeps these draws apart from all others that a condition's seed decides

T = TypeVar("T")
Sensing = Literal["ideal", "real"]


@dataclass(frozen=True, slots=True)
class Delays:
    """The delays of an episode, in control steps.

    Attributes:
        sensing: Age of what planner and policy see.
        action: How long a command is on its way to the robot.
    """

    sensing: int = 0
    action: int = 0

    @staticmethod
    def drawn_by(condition: Condition, sensing: Sensing = "real") -> Delays:
        """Return the delays that a condition has: those that its seed decides with real sensing, none with ideal.

        Args:
            condition: The condition.
            sensing: What is sensed.
        """
        if sensing == "ideal":
            return Delays()
        rng = np.random.default_rng((condition.seed, _STREAM))
        return Delays(int(rng.integers(MOST_SENSING_DELAY + 1)), int(rng.integers(MOST_ACTION_DELAY + 1)))


class DelayLine(Generic[T]):
    """Hands every value on after a number of control steps.

    Args:
        waiting: The values on their way at t = 0, oldest first; as many as there are control steps of delay.
    """

    def __init__(self, waiting: Iterable[T] = ()) -> None:
        self._waiting = deque(waiting)

    def push(self, value: T) -> T:
        """Take in the value of this control step and return the one that arrives in it."""
        self._waiting.append(value)
        return self._waiting.popleft()
