"""Where an object's path, a line or an arc, enters the disc around the robot's base in which objects can be handled."""

from __future__ import annotations

import math

from dynaforge.geometry import Pose, rotation_z


def distance_to_disc(frame: Pose, radius: float) -> float:
    """Return the distance along x of `frame` to the disc of `radius` metres around the world's z axis.

    A line that misses the disc counts to its point nearest to the axis. Zero or less means already inside.
    """
    x, y = float(frame.position[0]), float(frame.position[1])
    ux, uy = float(frame.rotation[0, 0]), float(frame.rotation[1, 0])
    nearest = -(x * ux + y * uy)
    half_chord_squared = radius * radius - (x * uy - y * ux) ** 2
    return nearest - math.sqrt(max(0.0, half_chord_squared))


def along_arc(frame: Pose, turn: float, distance: float) -> Pose:
    """Return a frame moved along a circle to which its x axis is a tangent.

    Args:
        frame: The frame.
        turn: Radius of the circle, metres; positive: the frame turns left, negative: right.
        distance: Distance along the circle, metres.
    """
    rotation = rotation_z(distance / turn)
    from_centre = frame.rotation @ (0.0, -turn, 0.0)
    return Pose(rotation @ frame.rotation, frame.position - from_centre + rotation @ from_centre)


def arc_to_disc(frame: Pose, turn: float, radius: float) -> float:
    """Return the distance along the circle of `along_arc` to a disc around the world's z axis, as `distance_to_disc`.

    Args:
        frame: The frame.
        turn: Radius of the circle, metres; positive: the frame turns left, negative: right.
        radius: Radius of the disc, metres.
    """
    from_centre = frame.rotation @ (0.0, -turn, 0.0)
    centre = frame.position - from_centre
    centre_distance = math.hypot(float(centre[0]), float(centre[1]))
    # The point of the circle nearest to the axis lies at this angle from the frame.
    ahead = math.atan2(-float(centre[1]), -float(centre[0])) - math.atan2(float(from_centre[1]), float(from_centre[0]))
    nearest = math.remainder(math.copysign(1.0, turn) * ahead, 2 * math.pi)
    cosine = (turn * turn + centre_distance * centre_distance - radius * radius) / (2 * abs(turn) * centre_distance)
    return abs(turn) * (nearest - math.acos(min(1.0, max(-1.0, cosine))))
