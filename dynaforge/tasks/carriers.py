"""Carriers: fixtures that move what they carry back and forth on a rail, or in circles on an arm."""

from __future__ import annotations

import math

import numpy as np

from dynaforge.geometry import Array, Pose, rotation_z
from dynaforge.sim.spec import Drive, Placement

DRIVEN = ("slide", "turn")
LEVELLED = (*DRIVEN, "level")  # the joints of a carrier with a third one, at the end of its arm


def peak_speed(mean: float, motion: float) -> float:
    """Return the speed that `carrier` takes, for a motion of a given mean speed.

    A slide that is as fast at its peak as a turning carrier all the time is slower on the average, and easier to
    follow. By their mean speed, the two kinds are ordered by what is hard.

    Args:
        mean: Mean speed, m/s.
        motion: Below zero the carrier slides back and forth, otherwise it turns.
    """
    return mean if motion >= 0.0 else -mean * math.pi / 2


def carrier(centre: Array, speed: float, *, yaw: float, phase: float, arm: float, swing: float) -> Placement:
    """Place a carrier so that what it carries moves about a centre.

    Its URDF has a joint `slide` along the base's y axis, after it a joint `turn` about z, and after that an arm along
    x.

    Args:
        centre: Centre of the oscillation or of the circle, on the table, metres, shape (3,).
        speed: Its magnitude is the peak speed, m/s. Below zero the carrier slides back and forth, otherwise it turns.
        yaw: Yaw of the base, radians.
        phase: Phase of the oscillation, or angle on the circle, at t = 0, radians in [-pi, pi]. Its sign is the
            direction in which a carrier turns.
        arm: Length of the arm, metres.
        swing: Amplitude of the oscillation, metres.
    """
    base = rotation_z(yaw)
    if speed >= 0.0:
        return Placement(Pose(base, centre), {"turn": Drive(start=phase, rate=math.copysign(speed / arm, phase))})
    drive = Drive(start=swing * math.sin(phase), amplitude=swing, frequency=-speed / swing, phase=phase)
    return Placement(Pose(base, centre - arm * base[:, 0]), {"slide": drive})


def levelled(placement: Placement, spin: float) -> Placement:
    """Drive the joint `level` at the end of the arm so that what is carried turns at `spin` rad/s only.

    The joint undoes the turning of the arm.
    """
    turn = placement.drives.get("turn", Drive())
    level = Drive(start=-turn.start, rate=spin - turn.rate)
    return Placement(placement.pose, {**placement.drives, "level": level})


def carried(placement: Placement, *, arm: float, height: float) -> tuple[Pose, Array, Array]:
    """Return pose, velocity and angular velocity of the end of the arm at t = 0, in the world frame.

    Args:
        placement: The carrier, as `carrier` and `levelled` place it.
        arm: Length of the arm, metres.
        height: Height of the point above the base, metres.
    """
    base = placement.pose
    slide, turn, level = (placement.drives.get(name, Drive()) for name in LEVELLED)
    z = np.array((0.0, 0.0, 1.0))
    end = arm * (base.rotation @ rotation_z(turn.start))[:, 0]
    pose = Pose(
        base.rotation @ rotation_z(turn.start + level.start),
        base.position + slide.start * base.rotation[:, 1] + end + height * z,
    )
    velocity = slide.speed(0.0) * base.rotation[:, 1] + turn.speed(0.0) * np.cross(z, end)
    return pose, velocity, (turn.speed(0.0) + level.speed(0.0)) * z
