"""The names of generators and what each takes: light to import, so that a command refuses a slip at once."""

from __future__ import annotations

GENERATORS = ("planner_only", "residual", "exploring", "oracle", "learner")
"""What `make_generator` makes."""

COLLECTING = ("residual", "planner_only")
"""Generators that collect: the oracle knows the outcome beforehand, exploring is for training."""

SETTINGS = {"policy": ("residual", "exploring"), "oracle_tries": ("oracle",), "sigma": ("exploring",)}
"""The generators that take each setting of `make_generator`."""
