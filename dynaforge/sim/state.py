"""A frozen snapshot of the scene, the only thing that predicates, planners and observations read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

from dynaforge.geometry import Array, Pose, one_line
from dynaforge.sim.contacts import NO_CONTACTS, Contacts
from dynaforge.sim.loads import NO_LOADS, StepLoads


class BodyColumn(NamedTuple):
    """One quantity of a body, in world coordinates.

    Attributes:
        size: Number of components.
        unit: SI unit; "-" for none.
        meaning: What it is, in one sentence.
    """

    size: int
    unit: str
    meaning: str


BODY_COLUMNS: Mapping[str, BodyColumn] = MappingProxyType(
    {
        "position": BodyColumn(3, "m", "Origin of the body."),
        "quat_wxyz": BodyColumn(4, "-", "Orientation of the body, unit quaternion."),
        "velocity": BodyColumn(3, "m/s", "Linear velocity of its centre of mass."),
        "angular_velocity": BodyColumn(3, "rad/s", "Angular velocity."),
    }
)
"""What recordings, observations and exports store of a body, in this order; `BodyState.columns` returns the values."""


@dataclass(frozen=True, slots=True, eq=False)
class BodyState:
    """Pose and velocities of one body.

    Attributes:
        pose: `T_world_body`.
        velocity: Linear velocity of its centre of mass, world frame, m/s, shape (3,).
        angular_velocity: Angular velocity, world frame, rad/s, shape (3,).
    """

    pose: Pose
    velocity: Array
    angular_velocity: Array

    __repr__ = one_line

    @property
    def columns(self) -> dict[str, Array]:
        """Its values by the names of `BODY_COLUMNS`, in that order."""
        values = (self.pose.position, self.pose.quat_wxyz, self.velocity, self.angular_velocity)
        return dict(zip(BODY_COLUMNS, values, strict=True))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneState:
    """The measured scene at the end of a control step.

    Attributes:
        time: Seconds of simulated time since reset.
        q, dq: Measured arm joint positions (rad) and velocities (rad/s), shape (7,).
        ee: `T_world_ee`, measured.
        width: Measured opening between the fingers, metres.
        objects: Free bodies, and the tracked links of fixtures, by name.
        touching: For each of these, whether the left and the right finger press on it, however lightly.
        on_table: For each free body, whether the table carries some of its weight.
        stopped: Whether the robot stopped itself because a joint moved too fast.
        overloaded: Whether its collision reflex has stopped it.
        loads: The external loads on it during the control step.
        pressed: For each fixture with a spring, how far it is pressed in, metres.
        contacts: Who presses on whom, and how hard.
    """

    time: float
    q: Array
    dq: Array
    ee: Pose
    width: float
    objects: Mapping[str, BodyState]
    touching: Mapping[str, tuple[bool, bool]]
    on_table: Mapping[str, bool]
    stopped: bool = False
    overloaded: bool = False
    loads: StepLoads = NO_LOADS
    pressed: Mapping[str, float] = field(default_factory=dict)
    contacts: Contacts = NO_CONTACTS

    def __repr__(self) -> str:
        return f"SceneState({self.time:.3f} s, {', '.join(self.objects)}, hand {1e3 * self.width:.0f} mm open)"
