"""How a condition starts the bodies and fixtures of a scene: plain data that `launch` returns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields

from dynaforge.geometry import Array, Pose, one_line
from dynaforge.sim.checks import check_kind, check_number, check_pose, check_whole, finite_array


@dataclass(frozen=True, slots=True, eq=False)
class Launch:
    """The start of one free body; afterwards only physics moves it.

    Attributes:
        pose: `T_world_body` at t = 0.
        velocity: Linear velocity of the centre of mass, world frame, m/s, shape (3,).
        angular_velocity: World frame, rad/s, shape (3,).
        mass: Mass of the root link, kilograms.
        joint_speeds: Speeds at t = 0 of joints that turn freely (wheels), rad/s; other joints stand still.
    """

    pose: Pose
    velocity: Array
    angular_velocity: Array
    mass: float
    joint_speeds: Mapping[str, float] = field(default_factory=dict)

    __repr__ = one_line

    def __post_init__(self) -> None:
        check_pose("Launch: pose", self.pose)
        for name in ("velocity", "angular_velocity"):
            object.__setattr__(self, name, finite_array(f"Launch: {name}", getattr(self, name), (3,)))
        check_number("Launch: mass", self.mass, above=0.0)
        check_kind("Launch: joint_speeds", self.joint_speeds, Mapping)
        for joint, speed in self.joint_speeds.items():
            check_number(f"Launch: joint_speeds[{joint!r}]", speed)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """How a motor moves one joint of a fixture: steadily, to and fro, or both.

    q(t) = start + rate t + amplitude (sin(w t + phase) - sin(phase)), where w is `frequency`.

    Attributes:
        start: Position at t = 0, rad or m.
        rate: Constant part of the speed, rad/s or m/s.
        amplitude: Amplitude of the swing to and fro, rad or m.
        frequency: Angular frequency of the swing, rad/s; its peak speed is amplitude * frequency.
        phase: Phase of the swing at t = 0, rad.
    """

    start: float = 0.0
    rate: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        for part in fields(self):
            check_number(f"Drive: {part.name}", getattr(self, part.name))

    def position(self, time: float) -> float:
        """Return where the joint should be at a time (s), rad or m."""
        swing = math.sin(self.frequency * time + self.phase) - math.sin(self.phase)
        return self.start + self.rate * time + self.amplitude * swing

    def speed(self, time: float) -> float:
        """Return how fast the joint should move at a time (s), rad/s or m/s."""
        return self.rate + self.amplitude * self.frequency * math.cos(self.frequency * time + self.phase)


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where a condition puts a fixture, and how its joints are driven.

    Attributes:
        pose: `T_world_base` for the whole episode.
        drives: Joint name to its drive; a driven joint that is not named stays at 0.
        variant: Index of the fixture's URDF that is used.
    """

    pose: Pose
    drives: Mapping[str, Drive] = field(default_factory=dict)
    variant: int = 0

    def __post_init__(self) -> None:
        check_pose("Placement: pose", self.pose)
        check_whole("Placement: variant", self.variant, least=0)
        check_kind("Placement: drives", self.drives, Mapping)
        for joint, drive in self.drives.items():
            check_kind(f"Placement: drives[{joint!r}]", drive, Drive)
