"""What a scene contains and how a condition starts it, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from importlib.resources import as_file, files
from pathlib import Path
from xml.etree import ElementTree

from dynaforge.sim.checks import (
    check_callable,
    check_kind,
    check_name,
    check_number,
    check_text,
    check_tuple,
    check_whole,
    close_match,
    quoted,
)
from dynaforge.sim.condition import Condition
from dynaforge.sim.starts import Drive, Launch, Placement

__all__ = ["BodySpec", "Drive", "FixtureSpec", "Launch", "Placement", "SceneSpec", "Spring", "asset_path", "check_urdf"]

RESERVED = ("robot", "table")  # names of what is in every scene
MAX_CONTROL_DT = 1.0  # seconds; a larger value is a rate mistaken for a period


@dataclass(frozen=True, slots=True)
class Spring:
    """A joint that a spring holds at 0, such as a button's.

    Attributes:
        joint: Name of the joint; pressing moves it below 0.
        force: Force with which the spring pushes back, newtons.
    """

    joint: str
    force: float

    def __post_init__(self) -> None:
        check_text("Spring: joint", self.joint)
        check_number("Spring: force", self.force, above=0.0)


@dataclass(frozen=True, slots=True)
class FixtureSpec:
    """A body on a fixed base, whose joints are driven by motors inside physics or held by a spring.

    Attributes:
        name: Its name in `SceneState.objects`.
        urdf: Its file below `assets/`, or several files of which a condition chooses one (`Placement.variant`).
        link: The link whose frame is tracked, e.g. the bowl, the pad, the button.
        driven: Names of the joints that motors drive; empty for scenery that never moves.
        spring: The one joint that a spring holds, if any.
        lateral_friction: Coulomb coefficient.
        rolling_friction: Bullet's rolling friction, a friction length in metres.
    """

    name: str
    urdf: str | tuple[str, ...]
    link: str
    _: KW_ONLY
    driven: tuple[str, ...] = ()
    spring: Spring | None = None
    lateral_friction: float = 0.8
    rolling_friction: float = 0.0

    def __post_init__(self) -> None:
        check_name("FixtureSpec: name", self.name, taken=RESERVED)
        place = f"Fixture {self.name!r}"
        for name in ("urdf", "driven"):
            if not isinstance(getattr(self, name), str):
                object.__setattr__(self, name, check_tuple(f"{place}: {name}", getattr(self, name), str))
        if isinstance(self.driven, str):
            raise ValueError(f"{place}: driven is {self.driven!r}; it must be a tuple: ({self.driven!r},).")
        check_kind(f"{place}: spring", self.spring, (Spring, type(None)))
        check_text(f"{place}: link", self.link)
        _check_friction(place, self, "lateral_friction", "rolling_friction")
        if not self.urdfs:
            raise ValueError(f"{place} has no URDF.")
        moved = [*self.driven, self.spring.joint] if self.spring else [*self.driven]
        if twice := [joint for joint in moved if moved.count(joint) > 1]:
            raise ValueError(f"{place}: the joint {twice[0]!r} is named twice among driven and the spring's.")
        for urdf in self.urdfs:
            links, joints = _read(place, urdf)
            if self.link not in links:
                raise ValueError(f"{place}: {urdf} has no link {quoted(self.link)}; it has {sorted(links)}.")
            for joint in moved:
                if joint not in joints:
                    raise ValueError(f"{place}: {urdf} has no joint {joint!r}; it has {sorted(joints)}.")
                if joints[joint] == "fixed":
                    raise ValueError(f"{place}: the joint {joint!r} of {urdf} is fixed, so nothing can move it.")

    @property
    def urdfs(self) -> tuple[str, ...]:
        """The files of all variants."""
        return (self.urdf,) if isinstance(self.urdf, str) else self.urdf

    def check_placement(self, placement: Placement) -> None:
        """Raise ValueError unless a placement chooses a variant that exists, and drives only joints in `driven`."""
        if placement.variant >= len(self.urdfs):
            raise ValueError(f"Fixture {self.name!r} has no variant {placement.variant}; it has {len(self.urdfs)}.")
        if unknown := sorted(set(placement.drives) - set(self.driven)):
            raise ValueError(f"Fixture {self.name!r} drives {self.driven}, not {unknown}.")


@dataclass(frozen=True, slots=True)
class BodySpec:
    """A free body of the scene. Joints of its URDF, such as axles, turn without motors and friction.

    Attributes:
        name: Its name in `SceneState.objects`.
        urdf: Its file below `assets/`.
        lateral_friction: Coulomb coefficient.
        rolling_friction: Bullet's rolling friction, a friction length in metres. Below 2e-4 m rolling is unstable.
        spinning_friction: Friction length in metres. Leave it at zero: above, Bullet accelerates rolling bodies.
    """

    name: str
    urdf: str
    _: KW_ONLY
    lateral_friction: float = 0.8
    rolling_friction: float = 2e-4
    spinning_friction: float = 0.0

    def __post_init__(self) -> None:
        check_name("BodySpec: name", self.name, taken=RESERVED)
        place = f"Body {self.name!r}"
        _check_friction(place, self, "lateral_friction", "rolling_friction", "spinning_friction")
        _read(place, self.urdf)

    def check_launch(self, launch: Launch) -> None:
        """Raise ValueError if a launch turns a joint that the body's URDF lacks."""
        joints = _read(f"Body {self.name!r}", self.urdf)[1] if launch.joint_speeds else {}
        if unknown := [joint for joint in launch.joint_speeds if joint not in joints]:
            raise ValueError(f"Body {self.name!r} has no joints {unknown}; {self.urdf} has {sorted(joints)}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSpec:
    """The physical scene of a task.

    Attributes:
        bodies: The free bodies; robot and table are in every scene.
        launch: Returns for a condition the start of every free body and the placement of every fixture. It must be a
            module-level function, so that it can be pickled.
        fixtures: Bodies on a fixed base.
        physics_dt: Seconds of one substep.
        control_dt: Seconds of one control step, a whole multiple of `physics_dt`.
        solver_iterations: Iterations of Bullet's contact solver.
        finger_friction: Coulomb coefficient of the finger pads.
    """

    bodies: tuple[BodySpec, ...]
    launch: Callable[[Condition], Mapping[str, Launch | Placement]]
    fixtures: tuple[FixtureSpec, ...] = ()
    physics_dt: float = 1 / 240
    control_dt: float = 1 / 30
    solver_iterations: int = 20
    finger_friction: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "bodies", check_tuple("SceneSpec: bodies", self.bodies, BodySpec))
        object.__setattr__(self, "fixtures", check_tuple("SceneSpec: fixtures", self.fixtures, FixtureSpec))
        check_callable("SceneSpec: launch", self.launch, expected="a function of a condition")
        if twice := sorted({name for name in self.names if self.names.count(name) > 1}):
            raise ValueError(
                f"SceneSpec: several bodies or fixtures are called {twice[0]!r}; each has a name of its own."
            )
        if not self.tracked:
            raise ValueError("SceneSpec: nothing in the scene moves; give it bodies, or fixtures with a joint.")
        check_number("SceneSpec: physics_dt", self.physics_dt, above=0.0)
        check_number("SceneSpec: control_dt", self.control_dt, above=0.0, most=MAX_CONTROL_DT)
        ratio = self.control_dt / self.physics_dt
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise ValueError(
                f"SceneSpec: control_dt {self.control_dt:g} s is {ratio:g} times physics_dt {self.physics_dt:g} s; "
                "it must be a whole multiple of it."
            )
        check_whole("SceneSpec: solver_iterations", self.solver_iterations, least=1)
        _check_friction("SceneSpec", self, "finger_friction")

    def starts(self, condition: Condition) -> Mapping[str, Launch | Placement]:
        """Return what `launch` returns for a condition: a Launch for every body and a Placement for every fixture.

        Raises:
            ValueError: It raises, leaves a body or fixture out, names one that is not in the scene, or returns anything
                else for one.
        """
        name = getattr(self.launch, "__qualname__", type(self.launch).__name__)
        who = "launch" if name == "launch" else f"launch ({name})"
        try:
            starts = self.launch(condition)
        except Exception as error:  # user-defined code: whatever it raises is reported with its place
            key = error.args[0] if isinstance(error, KeyError) and error.args else ""
            hint = f" It has {sorted(condition.values)}.{close_match(key, condition.values)}" if key else ""
            raise ValueError(
                f"{who} raised {type(error).__name__}: {str(error).rstrip('.')} (at condition {condition.id}).{hint}"
            ) from error
        check_kind(f"What {who} returns", starts, Mapping)
        for name, start in starts.items():
            self._check_start(who, name, start)
        if forgotten := [name for name in self.names if name not in starts]:
            raise ValueError(f"{who} forgets {forgotten[0]!r}; it must say how every body and fixture starts.")
        return starts

    def _check_start(self, who: str, name: str, start: Launch | Placement) -> None:
        if name not in self.names:
            known = ", ".join(map(repr, self.names))
            raise ValueError(f"{who} starts {name!r}; the scene has {known}.{close_match(name, self.names)}")
        fixture = next((fixture for fixture in self.fixtures if fixture.name == name), None)
        place = f"{who}: the start of {'the body' if fixture is None else 'the fixture'} {name!r}"
        check_kind(place, start, Launch if fixture is None else Placement)
        if fixture is not None and isinstance(start, Placement):
            fixture.check_placement(start)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all bodies, then of all fixtures."""
        return (*(body.name for body in self.bodies), *(fixture.name for fixture in self.fixtures))

    @property
    def tracked(self) -> tuple[str, ...]:
        """Names of everything that moves or can be moved: free bodies, then fixtures with joints."""
        moving = (fixture.name for fixture in self.fixtures if fixture.driven or fixture.spring)
        return (*(body.name for body in self.bodies), *moving)

    @property
    def substeps(self) -> int:
        """Number of substeps in one control step."""
        return round(self.control_dt / self.physics_dt)

    @property
    def fps(self) -> int:
        """Control steps per second, rounded to a whole number for films and datasets."""
        return round(1 / self.control_dt)


def _check_friction(place: str, spec: object, *names: str) -> None:
    for name in names:
        check_number(f"{place}: {name}", getattr(spec, name), least=0.0)


def _read(place: str, urdf: str) -> tuple[set[str], dict[str, str]]:
    """Return what `check_urdf` does; errors name the body or fixture that the URDF belongs to."""
    check_text(f"{place}: urdf", urdf)
    try:
        return check_urdf(asset_path(urdf))
    except (ValueError, FileNotFoundError) as error:
        raise type(error)(f"{place}: urdf: {error}") from error


def check_urdf(path: Path) -> tuple[set[str], dict[str, str]]:
    """Check that a URDF is XML with one root link, since Bullet itself crashes if there are several.

    Returns:
        The names of its links, and the types of its joints by their names.

    Raises:
        ValueError: It is not; the message names the file.
    """
    try:
        robot = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"{path} is not XML, hence not a URDF: {error}.") from error
    links = {link.get("name", "") for link in robot.findall("link")}
    roots = links - {child.get("link") for child in robot.findall("joint/child")}
    if len(roots) != 1:
        raise ValueError(f"{path} is not a URDF that can be loaded: it has {len(roots)} root links, and needs one.")
    return links, {joint.get("name", ""): joint.get("type", "") for joint in robot.findall("joint")}


def asset_path(name: str) -> Path:
    """Locate a file below `assets/`; an absolute path stands for itself.

    Raises:
        FileNotFoundError: No such asset.
    """
    if Path(name).is_absolute():
        if not Path(name).is_file():
            raise FileNotFoundError(f"No file {name!r}.")
        return Path(name)
    with as_file(files("dynaforge.assets").joinpath(name)) as path, as_file(files("dynaforge.assets")) as assets:
        if not path.is_file():
            known = [file.relative_to(assets).as_posix() for file in assets.glob("*/*.urdf")]
            raise FileNotFoundError(
                f"No asset {name!r} in {assets}.{close_match(name, known)} "
                "A file of your own is given by its absolute path: str(Path(__file__).with_name(...))."
            )
        return path
