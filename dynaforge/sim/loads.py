"""External loads on the robot: what pushes against it, and how hard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaforge.geometry import Array, one_line


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
