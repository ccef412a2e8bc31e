"""External loads on the robot: what pushes against it, and how hard."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from dynaforge.geometry import Array, one_line
from dynaforge.sim.checks import check_number, quoted


@dataclass(frozen=True, slots=True, kw_only=True)
class Loads:
    """The greatest external loads on the robot in an episode.

    Attributes:
        peak_force: Net contact force of one substep, newtons.
        force: Net contact force, mean of two consecutive control steps, newtons.
        peak_torque: Torque that contacts cause at a joint, in one substep, Nm.
        torque: The same, mean of two consecutive control steps, Nm.
        contact, standard, strict: The load that lasted for two control steps in a row, as a share of the thresholds of
            that name; above 1, the reflex would have stopped the robot.
    """

    peak_force: float = 0.0
    force: float = 0.0
    peak_torque: float = 0.0
    torque: float = 0.0
    contact: float = 0.0
    standard: float = 0.0
    strict: float = 0.0

    __repr__ = one_line

    def __post_init__(self) -> None:
        for part in fields(self):
            check_number(f"Loads: {part.name}", getattr(self, part.name), least=0.0)

    @staticmethod
    def from_dict(data: Any) -> Loads:
        """Rebuild loads from `dataclasses.asdict`.

        Raises:
            ValueError: It is no mapping, a load is missing or unknown, or one is no number of at least 0.
        """
        names = [part.name for part in fields(Loads)]
        if not isinstance(data, dict) or sorted(data) != sorted(names):
            raise ValueError(f"loads is {quoted(data)}; it must be a mapping with {', '.join(names)}.")
        return Loads(**data)


@dataclass(frozen=True, slots=True, eq=False)
class StepLoads:
    """External loads on the robot during one control step.

    Attributes:
        force: Mean net contact force, world axes, newtons, shape (3,).
        torque: Mean torque that contacts cause at each joint, Nm, shape (7,).
        peak_force: Greatest net contact force of a substep, newtons.
        peak_torque: Greatest torque at a joint in a substep, Nm.
    """

    force: Array
    torque: Array
    peak_force: float
    peak_torque: float

    __repr__ = one_line


NO_LOADS = StepLoads(np.zeros(3), np.zeros(7), 0.0, 0.0)
