"""The planner with constant-velocity prediction: what a careful engineer would try first."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np

from dynaforge.demos import Episode
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.generator import ConstantResidual, ResidualGenerator
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_number
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import Task

LEAD_TIMES = "lead_times.json"
"""File of `assets/` with the lead time of every task: its name, or "default", to seconds."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """The planner only, aiming where constant velocity takes the object in `lead_time` seconds.

    Attributes:
        lead_time: Seconds of prediction in every target of the plan (`Task.lead_time`); with 0 it is the planner only.
        name: Its name in ledgers and reports.

    Raises:
        ValueError: The lead time is no number, or negative.
    """

    lead_time: float
    name: str = "prediction"

    def __post_init__(self) -> None:
        check_number("Prediction: lead_time", self.lead_time, least=0.0)

    def attempted(self, task: Task) -> Task:
        """Return the task with the lead time, which is part of the definition of what it attempts."""
        return replace(task, lead_time=self.lead_time)

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        """Run one episode and record it."""
        zero = ConstantResidual(np.zeros(env.action_space.shape or (), np.float32))
        return ResidualGenerator(zero, name=self.name).attempt(env, condition)


def chosen_lead_time(task: Task) -> float:
    """Return the lead time that is stored for a task, in seconds; for a task of your own the default one."""
    stored: dict[str, float] = json.loads(asset_path(LEAD_TIMES).read_text(encoding="utf-8"))
    return stored.get(task.name, stored["default"])
