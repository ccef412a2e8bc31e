"""Demonstrations of dynamic manipulation: a planning prior, a learned residual, FrontierGRPO.

Importing this package registers `DynaForge/<Task>-v0` (residual action) and `DynaForge/<Task>Task-v0` (absolute
action) with Gymnasium.
"""

from importlib.metadata import version

from dynaforge.registration import register_envs

__version__ = version("dynaforge")

register_envs()
