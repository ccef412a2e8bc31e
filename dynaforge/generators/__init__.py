"""Generators make episodes: the planner, a residual policy, the oracle, a learner; attempts run on all cores.

Each name is imported when it is first used, so that importing `dynaforge.generators.names` loads no physics.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynaforge.generators.attempts import Result, attempt_once, run_attempts
    from dynaforge.generators.by_name import make_generator
    from dynaforge.generators.collecting import ConditionSource, Goal, collect
    from dynaforge.generators.generator import (
        ConstantResidual,
        ExploringPolicy,
        Generator,
        PlannerOnly,
        ResidualGenerator,
    )
    from dynaforge.generators.giving_up import GaveUp
    from dynaforge.generators.learner import LearnerGenerator
    from dynaforge.generators.oracle import Oracle
    from dynaforge.generators.replay import SynchronisedReplay
    from dynaforge.sampling.processes import NoWorkers

__all__ = [
    "ConditionSource",
    "ConstantResidual",
    "ExploringPolicy",
    "GaveUp",
    "Generator",
    "Goal",
    "LearnerGenerator",
    "NoWorkers",
    "Oracle",
    "PlannerOnly",
    "ResidualGenerator",
    "Result",
    "SynchronisedReplay",
    "attempt_once",
    "collect",
    "make_generator",
    "run_attempts",
]

_MODULES = {
    "attempts": ("NoWorkers", "Result", "attempt_once", "run_attempts"),
    "by_name": ("make_generator",),
    "collecting": ("Goal", "ConditionSource", "collect"),
    "generator": ("ConstantResidual", "ExploringPolicy", "Generator", "PlannerOnly", "ResidualGenerator"),
    "giving_up": ("GaveUp",),
    "learner": ("LearnerGenerator",),
    "oracle": ("Oracle",),
    "replay": ("SynchronisedReplay",),
}


def __getattr__(name: str) -> Any:
    """Import a name of `__all__` when it is first used."""
    for module, names in _MODULES.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f"{__name__}.{module}"), name)
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
