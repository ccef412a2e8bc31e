"""The names of generators and the settings of each; quick to import, so that a command refuses a typo at once."""

from __future__ import annotations

from typing import Literal, get_args

GENERATORS = (
    "planner_only",
    "prediction",
    "dmp",
    "residual",
    "exploring",
    "oracle",
    "replay",
    "state_machine",
    "learner",
)
"""The generators that `make_generator` can make."""

COLLECTING = ("residual", "planner_only", "prediction", "dmp", "replay", "state_machine")
"""Generators for collecting; the oracle knows the outcome beforehand, and exploration is for training."""

GRPO = "grpo"
"""What tables call the generator "residual" with policies that were trained by vanilla GRPO."""

SETTINGS = {
    "policy": ("residual", "exploring"),
    "lead_time": ("prediction",),
    "source": ("dmp",),
    "oracle_tries": ("oracle",),
    "sigma": ("exploring",),
    "level": ("replay",),
    "release": ("replay",),
    "object_speed": ("replay",),
}
"""The generators that take each setting of `make_generator`."""

Level = Literal[1, 2, 3]
"""Shapes of the object's path in synchronised replay."""
LEVELS: tuple[Level, ...] = get_args(Level)
Speed = float | Literal["shipped", "task"]
"""Cap on the object's speed in synchronised replay, m/s; "shipped" is `SHIPPED`, "task" that of the condition."""
SLOWEST, SHIPPED, FASTEST = 0.01, 0.1, 2.0  # m/s; the last is beyond every speed of the tasks
