"""Demonstrations of dynamic manipulation: a planning prior, a learned residual, FrontierGRPO.

Importing this package registers `DynaForge/<Task>-v0` (residual action) and `DynaForge/<Task>Task-v0` (absolute
action) with Gymnasium, and those of the task files that the environment variable DYNAFORGE_TASKS lists.
"""

import os
from importlib.metadata import version

from dynaforge.registration import register_envs

__version__ = version("dynaforge")

register_envs()

if os.environ.get("DYNAFORGE_TASKS"):
    from dynaforge.tasks.task_file import register_listed_files

    register_listed_files()
