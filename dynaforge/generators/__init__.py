"""What makes episodes: the planner, the residual policy, the oracle; run on all cores."""

from dynaforge.generators.attempts import Result, run_attempts
from dynaforge.generators.generator import ConstantResidual, Exploring, Generator, PlannerOnly, ResidualGenerator
from dynaforge.generators.oracle import Oracle

__all__ = [
    "ConstantResidual",
    "Exploring",
    "Generator",
    "Oracle",
    "PlannerOnly",
    "ResidualGenerator",
    "Result",
    "run_attempts",
]
