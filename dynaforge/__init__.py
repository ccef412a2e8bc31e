"""Demonstrations of dynamic manipulation: a planner, a learned residual, FrontierGRPO.

Importing this package registers `DynaForge/<Task>-v0` (residual action) and `DynaForge/<Task>Task-v0` (absolute
action) with Gymnasium, and those of the task files that the environment variable DYNAFORGE_TASKS lists.

The public names are those in `__all__`: here, in `dynaforge.tasks.targets` and `dynaforge.tasks.predicates`, from which
phases are written, and in `dynaforge.evaluation`, the statistics. Names of this module are imported when they are first
used, so `import dynaforge` alone loads neither torch nor the physics engine.
"""

import os
import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path and "dynaforge" in (w.partition(".")[0] for w in sys.orig_argv):
    # Run as `python -m dynaforge`, the current folder stands first: a json.py in it must not stand in for the real one.
    sys.path.append(sys.path.pop(0))

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from dynaforge.registration import register_envs

if TYPE_CHECKING:
    from dynaforge.algos.frontier_grpo import FrontierGRPO
    from dynaforge.algos.policy_file import MlpPolicyFile
    from dynaforge.demos.dataset import DemonstrationDataset
    from dynaforge.demos.episode import Attempt, Episode
    from dynaforge.demos.exporters.frames import Frames, read_frames
    from dynaforge.demos.observations import ObservationFolder
    from dynaforge.demos.pack import Pack
    from dynaforge.demos.untrusted import DamagedFileError
    from dynaforge.envs.residual_env import ResidualEnv
    from dynaforge.envs.task_env import TaskEnv
    from dynaforge.generators.attempts import run_attempts
    from dynaforge.generators.bridge import ExportBridge
    from dynaforge.generators.collecting import ConditionSource, Goal, collect
    from dynaforge.generators.generator import Generator, PlannerOnly, ResidualGenerator
    from dynaforge.generators.giving_up import GaveUp
    from dynaforge.generators.learner import LearnerGenerator
    from dynaforge.geometry.pose import Pose, rotation_z
    from dynaforge.sampling.vector_env import SharedMemoryVecEnv
    from dynaforge.sim.condition import Condition
    from dynaforge.sim.spec import BodySpec, Drive, FixtureSpec, Launch, Placement, SceneSpec, Spring
    from dynaforge.tasks import TASK_NAMES, get_task
    from dynaforge.tasks.action import ActionLayout
    from dynaforge.tasks.conditions import ConditionSpace
    from dynaforge.tasks.outcome import Outcome
    from dynaforge.tasks.phase import Mode, Phase
    from dynaforge.tasks.task import ResidualSpec, Task
    from dynaforge.tasks.view import PhaseView
    from dynaforge.tasks.words import ObjectName
    from dynaforge.training.settings import recommended

__all__ = [
    "TASK_NAMES",
    "ActionLayout",
    "Attempt",
    "BodySpec",
    "Condition",
    "ConditionSource",
    "ConditionSpace",
    "DamagedFileError",
    "DemonstrationDataset",
    "Drive",
    "Episode",
    "ExportBridge",
    "FixtureSpec",
    "Frames",
    "FrontierGRPO",
    "GaveUp",
    "Generator",
    "Goal",
    "Launch",
    "LearnerGenerator",
    "MlpPolicyFile",
    "Mode",
    "ObjectName",
    "ObservationFolder",
    "Outcome",
    "Pack",
    "Phase",
    "PhaseView",
    "Placement",
    "PlannerOnly",
    "Pose",
    "ResidualEnv",
    "ResidualGenerator",
    "ResidualSpec",
    "SceneSpec",
    "SharedMemoryVecEnv",
    "Spring",
    "Task",
    "TaskEnv",
    "collect",
    "get_task",
    "read_frames",
    "recommended",
    "rotation_z",
    "run_attempts",
]

# Where each public name is defined; the imports above say the same to type checkers.
_HOMES = {
    "dynaforge.algos.frontier_grpo": ("FrontierGRPO",),
    "dynaforge.algos.policy_file": ("MlpPolicyFile",),
    "dynaforge.training.settings": ("recommended",),
    "dynaforge.demos.dataset": ("DemonstrationDataset",),
    "dynaforge.demos.episode": ("Attempt", "Episode"),
    "dynaforge.demos.exporters.frames": ("Frames", "read_frames"),
    "dynaforge.demos.observations": ("ObservationFolder",),
    "dynaforge.demos.pack": ("Pack",),
    "dynaforge.demos.untrusted": ("DamagedFileError",),
    "dynaforge.envs.residual_env": ("ResidualEnv",),
    "dynaforge.envs.task_env": ("TaskEnv",),
    "dynaforge.sampling.vector_env": ("SharedMemoryVecEnv",),
    "dynaforge.generators.attempts": ("run_attempts",),
    "dynaforge.generators.bridge": ("ExportBridge",),
    "dynaforge.generators.collecting": ("Goal", "ConditionSource", "collect"),
    "dynaforge.generators.generator": ("Generator", "PlannerOnly", "ResidualGenerator"),
    "dynaforge.generators.giving_up": ("GaveUp",),
    "dynaforge.generators.learner": ("LearnerGenerator",),
    "dynaforge.geometry.pose": ("Pose", "rotation_z"),
    "dynaforge.sim.condition": ("Condition",),
    "dynaforge.sim.spec": ("BodySpec", "Drive", "FixtureSpec", "Launch", "Placement", "SceneSpec", "Spring"),
    "dynaforge.tasks": ("TASK_NAMES", "get_task"),
    "dynaforge.tasks.action": ("ActionLayout",),
    "dynaforge.tasks.conditions": ("ConditionSpace",),
    "dynaforge.tasks.outcome": ("Outcome",),
    "dynaforge.tasks.phase": ("Mode", "Phase"),
    "dynaforge.tasks.task": ("ResidualSpec", "Task"),
    "dynaforge.tasks.view": ("PhaseView",),
    "dynaforge.tasks.words": ("ObjectName",),
}

__version__ = version("dynaforge")

register_envs()


if not TYPE_CHECKING:  # or type checkers would believe in any name

    def __getattr__(name: str) -> Any:
        """Import a public name when it is first used."""
        for module, names in _HOMES.items():
            if name in names:
                value = globals()[name] = getattr(import_module(module), name)
                return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if os.environ.get("DYNAFORGE_TASKS"):  # last, so that a task file may import any public name
    from dynaforge.tasks.task_file import register_listed_files

    register_listed_files()
