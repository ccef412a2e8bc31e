"""Rolling past: where an object starts that goes straight across the plane ahead of the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dynaforge.geometry import Pose, rotation_z
from dynaforge.tasks.targets import distance_to_disc


def start_of_roll(values: Mapping[str, float], *, height: float, reach: float) -> Pose:
    """Return the heading frame at t = 0 of an object that is launched straight past the robot.

    Args:
        values: Of the condition. `speed` (m/s); `side`, whose sign is that of the way along y; `heading`, off the
            straight line across (rad); `cross_x`, `cross_y`, where its line crosses the plane ahead (m); `lead`,
            seconds at launch speed until it enters the reach.
        height: Of its origin above the table, metres.
        reach: Radius of the disc around the robot's base in which objects can be handled, metres.
    """
    rotation = rotation_z(math.copysign(math.pi / 2, values["side"]) + values["heading"])
    crossing = np.array((values["cross_x"], values["cross_y"], height))
    distance = values["speed"] * values["lead"] - distance_to_disc(Pose(rotation, crossing), reach)
    return Pose(rotation, crossing - distance * rotation[:, 0])
