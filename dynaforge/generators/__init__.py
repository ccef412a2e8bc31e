"""What makes episodes: the planner, the residual policy, the oracle; run on all cores."""

from dynaforge.generators.attempts import NoWorkers, Result, attempt_once, run_attempts
from dynaforge.generators.collect import Goal, Source, collect
from dynaforge.generators.generator import ConstantResidual, Exploring, Generator, PlannerOnly, ResidualGenerator
from dynaforge.generators.giving_up import GaveUp
from dynaforge.generators.learner import LearnerGenerator
from dynaforge.generators.oracle import Oracle

__all__ = [
    "ConstantResidual",
    "Exploring",
    "GaveUp",
    "Generator",
    "Goal",
    "LearnerGenerator",
    "NoWorkers",
    "Oracle",
    "PlannerOnly",
    "ResidualGenerator",
    "Result",
    "Source",
    "attempt_once",
    "collect",
    "run_attempts",
]
