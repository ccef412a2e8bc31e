"""What a scene holds and how a condition launches it: plain data."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from xml.etree import ElementTree

from dynaforge.geometry import Array, Pose
from dynaforge.sim.condition import Condition


@dataclass(frozen=True, slots=True, eq=False)
class Launch:
    """How one free body starts: afterwards physics alone moves it.

    Attributes:
        pose: `T_world_body` at t = 0.
        velocity: Linear velocity of the centre of mass, world frame, m/s, shape (3,).
        angular_velocity: World frame, rad/s, shape (3,).
        mass: Kilograms, of the root link.
        joint_speeds: Rates at t = 0 of joints that turn freely (wheels), rad/s; a joint not named stands still.
    """

    pose: Pose
    velocity: Array
    angular_velocity: Array
    mass: float
    joint_speeds: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Drive:
    """How a joint motor moves one joint of a fixture: steadily, to and fro, or both.

    q(t) = start + rate t + amplitude (sin(w t + phase) - sin(phase)).

    Attributes:
        start: Position at t = 0, rad or m.
        rate: Constant part of the speed, rad/s or m/s.
        amplitude: Of the swing to and fro, rad or m.
        frequency: w, rad/s; the swing's peak speed is amplitude * frequency.
        phase: Where in its swing it starts, rad.
    """

    start: float = 0.0
    rate: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    phase: float = 0.0

    def position(self, time: float) -> float:
        """Where the joint should be, rad or m."""
        swing = math.sin(self.frequency * time + self.phase) - math.sin(self.phase)
        return self.start + self.rate * time + self.amplitude * swing

    def speed(self, time: float) -> float:
        """How fast it should move, rad/s or m/s."""
        return self.rate + self.amplitude * self.frequency * math.cos(self.frequency * time + self.phase)


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where a condition puts a fixture, and how its joints are driven.

    Attributes:
        pose: `T_world_base` for the whole episode.
        drives: Joint name to its drive; a driven joint not named stays at 0.
        variant: Which of the fixture's URDFs stands there.
    """

    pose: Pose
    drives: Mapping[str, Drive] = field(default_factory=dict)
    variant: int = 0


@dataclass(frozen=True, slots=True)
class Spring:
    """A joint that a spring holds at 0, such as a button's.

    Attributes:
        joint: Its name; pressing moves it below 0.
        force: With which the spring pushes back, newtons.
    """

    joint: str
    force: float


@dataclass(frozen=True, slots=True)
class FixtureSpec:
    """A body on a fixed base, whose joints a motor drives inside physics or a spring holds.

    Attributes:
        name: Its name in `SceneState.objects`.
        urdf: Its file below `assets/`, or several, of which a condition picks one (`Placement.variant`).
        link: The link whose frame is tracked: the bowl, the pad, the button.
        driven: Names of the joints that motors drive; none for scenery that never moves.
        spring: The one joint that a spring holds.
        lateral_friction: Coulomb coefficient.
        rolling_friction: Bullet's rolling friction, a torque arm in metres.
    """

    name: str
    urdf: str | tuple[str, ...]
    link: str
    driven: tuple[str, ...] = ()
    spring: Spring | None = None
    lateral_friction: float = 0.8
    rolling_friction: float = 0.0

    @property
    def urdfs(self) -> tuple[str, ...]:
        """All variants."""
        return (self.urdf,) if isinstance(self.urdf, str) else self.urdf


@dataclass(frozen=True, slots=True)
class BodySpec:
    """A free body of the scene. Joints of its URDF, such as axles, turn without motors and friction.

    Attributes:
        name: Its name in `SceneState.objects`.
        urdf: Its file below `assets/`.
        lateral_friction: Coulomb coefficient.
        rolling_friction: Bullet's rolling friction, a torque arm in metres. Below 2e-4 m rolling is unstable.
        spinning_friction: Torque arm in metres. Above zero it speeds up rolling bodies: leave it.
    """

    name: str
    urdf: str
    lateral_friction: float = 0.8
    rolling_friction: float = 2e-4
    spinning_friction: float = 0.0


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """The physical scene of a task.

    Attributes:
        bodies: The free bodies; the table and the robot are always there.
        launch: Turns a condition into the start of every free body and the placement of every fixture. A module-level
            function, so that it pickles.
        fixtures: Bodies on a fixed base.
        physics_dt: Seconds of one physics substep.
        control_dt: Seconds of one control step, a whole multiple of `physics_dt`.
        solver_iterations: Of Bullet's contact solver.
        finger_friction: Coulomb coefficient of the finger pads.
    """

    bodies: tuple[BodySpec, ...]
    launch: Callable[[Condition], Mapping[str, Launch | Placement]]
    fixtures: tuple[FixtureSpec, ...] = ()
    physics_dt: float = 1 / 240
    control_dt: float = 1 / 30
    solver_iterations: int = 20
    finger_friction: float = 1.0

    @property
    def tracked(self) -> tuple[str, ...]:
        """Names of everything that moves or can be moved: free bodies, then fixtures with joints."""
        moving = (fixture.name for fixture in self.fixtures if fixture.driven or fixture.spring)
        return (*(body.name for body in self.bodies), *moving)

    @property
    def substeps(self) -> int:
        """Physics substeps in one control step."""
        return round(self.control_dt / self.physics_dt)

    @property
    def fps(self) -> int:
        """Control steps a second, a whole number as films and datasets have it."""
        return round(1 / self.control_dt)


def check_urdf(path: Path) -> None:
    """Make sure that a URDF is XML with one root link, since Bullet itself crashes on one with more.

    Raises:
        ValueError: It is not; names the file.
    """
    try:
        robot = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"{path} is no XML, so no URDF: {error}.") from error
    links = {link.get("name") for link in robot.findall("link")}
    roots = links - {child.get("link") for child in robot.findall("joint/child")}
    if len(roots) != 1:
        raise ValueError(f"{path} is no URDF that can be loaded: it has {len(roots)} root links, and needs one.")


def asset_path(name: str) -> Path:
    """Locate a file below `assets/`; an absolute path stands for itself.

    Raises:
        FileNotFoundError: No such asset.
    """
    if Path(name).is_absolute():
        if not Path(name).is_file():
            raise FileNotFoundError(f"No file {name!r}.")
        return Path(name)
    with as_file(files("dynaforge.assets").joinpath(name)) as path:
        if not path.is_file():
            raise FileNotFoundError(f"No asset {name!r} in {path.parent}.")
        return path
