"""The part of an episode that all rollouts of a condition have in common: what comes before the first gate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynaforge.sim import Condition, SceneState
from dynaforge.sim.snapshot import Memory


class Answer(NamedTuple):
    """What an env answers to a step, in Gymnasium's order."""

    observation: NDArray[np.float32]
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]

    def copy(self) -> Answer:
        """Return one that the caller may change."""
        return self._replace(observation=self.observation.copy(), info=dict(self.info))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Prefix:
    """An episode up to its first gate.

    Attributes:
        condition: The condition of the episode.
        first_gate: The scene when the gate opened; `World.first_gate` is the same object while it can be restored.
        memory: Executor and observation history at that time.
        answers: What the env answered to the reset, and to all steps before the gate opened.
    """

    condition: Condition
    first_gate: SceneState
    memory: Memory
    answers: list[Answer]
