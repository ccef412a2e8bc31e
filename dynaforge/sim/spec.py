"""What a scene holds and how a condition launches it: plain data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
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
        mass: Kilograms.
    """

    pose: Pose
    velocity: Array
    angular_velocity: Array
    mass: float


@dataclass(frozen=True, slots=True)
class BodySpec:
    """A free body of the scene.

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
        launch: Turns a condition into the start of every free body. A module-level function, so that it pickles.
        physics_dt: Seconds of one physics substep.
        control_dt: Seconds of one control step, a whole multiple of `physics_dt`.
        solver_iterations: Of Bullet's contact solver.
        finger_friction: Coulomb coefficient of the finger pads.
    """

    bodies: tuple[BodySpec, ...]
    launch: Callable[[Condition], Mapping[str, Launch]]
    physics_dt: float = 1 / 240
    control_dt: float = 1 / 30
    solver_iterations: int = 20
    finger_friction: float = 1.0

    @property
    def substeps(self) -> int:
        """Physics substeps in one control step."""
        return round(self.control_dt / self.physics_dt)


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
    """Locate a file below `assets/`.

    Raises:
        FileNotFoundError: No such asset.
    """
    with as_file(files("dynaforge.assets").joinpath(name)) as path:
        if not path.is_file():
            raise FileNotFoundError(f"No asset {name!r} in {path.parent}.")
        return path
