"""Demonstrations of dynamic manipulation: a planning prior, a learned residual, FrontierGRPO.

Importing this package registers `DynaForge/<Task>-v0` (residual action) and `DynaForge/<Task>Task-v0` (absolute
action) with Gymnasium, and those of the task files that the environment variable DYNAFORGE_TASKS lists.
"""

import os
import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path and "dynaforge" in (w.partition(".")[0] for w in sys.orig_argv):
    # Run as `python -m dynaforge`, the current folder stands first: a json.py in it must not stand in for the real one.
    sys.path.append(sys.path.pop(0))

from importlib.metadata import version

from dynaforge.registration import register_envs

__version__ = version("dynaforge")

register_envs()

if os.environ.get("DYNAFORGE_TASKS"):
    from dynaforge.tasks.task_file import register_listed_files

    register_listed_files()
