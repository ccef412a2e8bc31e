"""A frozen snapshot of the scene: predicates, planners and observations read only this."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dynaforge.geometry import Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class BodyState:
    """Pose and twist of one body.

    Attributes:
        pose: `T_world_body`.
        velocity: Linear velocity of its centre of mass, world frame, m/s, shape (3,).
        angular_velocity: World frame, rad/s, shape (3,).
    """

    pose: Pose
    velocity: Array
    angular_velocity: Array


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """The measured scene at the end of a control step.

    Attributes:
        time: Seconds of simulated time since reset.
        q, dq: Measured arm joint positions (rad) and velocities (rad/s), shape (7,).
        ee: `T_world_ee`, measured.
        width: Measured opening between the fingers, metres.
        objects: Free bodies and fixtures (their tracked link) by name.
        touching: For each of them, whether the left and the right finger touch it.
        on_table: For each free body, whether it touches the table.
        stopped: Whether the robot stopped itself because a joint became too fast.
        pressed: For each fixture with a spring, how far it is pressed in, metres.
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
    pressed: Mapping[str, float] = field(default_factory=dict)
