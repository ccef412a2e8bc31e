"""Carriers: fixtures that move what they carry to and fro on a rail, or round and round on an arm."""

from __future__ import annotations

import math

import numpy as np

from dynaforge.geometry import Array, Pose, rotation_z
from dynaforge.sim.spec import Drive, Placement

DRIVEN = ("slide", "turn")
LEVELLED = (*DRIVEN, "level")  # of a carrier with a third joint, at the arm's end


def carrier(centre: Array, speed: float, *, yaw: float, phase: float, arm: float, swing: float) -> Placement:
    """Place a carrier so that what it carries moves about a centre.

    Its URDF has a joint `slide` along y of its base, on that a joint `turn` about z, and on that an arm along x.

    Args:
        centre: Of the swing or of the circle, on the table, metres, shape (3,).
        speed: Its magnitude is the peak speed, m/s; below zero it slides to and fro, else it turns.
        yaw: Of the base, radians: the rail stands across it.
        phase: In its swing or on its circle at t = 0, radians in [-pi, pi]; by its sign a carrier turns left or right.
        arm: Length of the arm, metres.
        swing: Amplitude to and fro, metres.
    """
    base = rotation_z(yaw)
    if speed >= 0.0:
        return Placement(Pose(base, centre), {"turn": Drive(start=phase, rate=math.copysign(speed / arm, phase))})
    drive = Drive(start=swing * math.sin(phase), amplitude=swing, frequency=-speed / swing, phase=phase)
    return Placement(Pose(base, centre - arm * base[:, 0]), {"slide": drive})


def levelled(placement: Placement, spin: float) -> Placement:
    """Let the joint `level` at the arm's end undo the arm's turning: what is carried turns at `spin` rad/s only."""
    turn = placement.drives.get("turn", Drive())
    level = Drive(start=-turn.start, rate=spin - turn.rate)
    return Placement(placement.pose, {**placement.drives, "level": level})


def carried(placement: Placement, *, arm: float, height: float) -> tuple[Pose, Array, Array]:
    """Return pose, velocity and angular velocity, world frame, of the arm's end at t = 0, `height` above the base."""
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
