"""The names of generators and the settings of each; quick to import, so that a command refuses a typo at once."""

from __future__ import annotations

GENERATORS = ("planner_only", "prediction", "residual", "exploring", "oracle", "learner")
"""The generators that `make_generator` can make."""

COLLECTING = ("residual", "planner_only", "prediction")
"""Generators for collecting; the oracle knows the outcome beforehand, and exploration is for training."""

SETTINGS = {
    "policy": ("residual", "exploring"),
    "lead_time": ("prediction",),
    "oracle_tries": ("oracle",),
    "sigma": ("exploring",),
}
"""The generators that take each setting of `make_generator`."""
