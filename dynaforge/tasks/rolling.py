"""Where an object starts that rolls past the robot in a straight line."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dynaforge.geometry import Pose, rotation_z
from dynaforge.tasks.reach import distance_to_disc


def start_of_roll(values: Mapping[str, float], *, height: float, reach: float) -> Pose:
    """Return the heading frame at t = 0 of an object that is launched straight past the robot.

    Args:
        values: The condition's values. `speed` (m/s); `side`: its sign is the direction of motion along y; `heading`:
            angle between the line and the y axis (rad); `cross_x`, `cross_y`: a point on the line in front of the
            robot (m); `lead`: seconds, at launch speed, until the object enters the reach.
        height: Height of the object's origin above the table, metres.
        reach: Radius of the disc around the robot's base in which objects can be handled, metres.
    """
    rotation = rotation_z(math.copysign(math.pi / 2, values["side"]) + values["heading"])
    crossing = np.array((values["cross_x"], values["cross_y"], height))
    distance = values["speed"] * values["lead"] - distance_to_disc(Pose(rotation, crossing), reach)
    return Pose(rotation, crossing - distance * rotation[:, 0])
