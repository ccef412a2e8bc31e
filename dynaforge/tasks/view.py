"""What targets and predicates read: the measured scene, as the running phase sees it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from dynaforge.geometry import Pose, one_line, rotation_z
from dynaforge.sim import BodyState, SceneState

HEADING_SPEED = 0.02  # m/s: below this speed a heading keeps its last direction


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PhaseView:
    """The scene at one control step, as the running phase sees it.

    Attributes:
        state: The latest measured scene.
        entry: The scene at the entry of this phase.
        start: The scene at t = 0.
        frames: Heading frame `T_world_heading` of every object: at its position, x along its horizontal velocity, z
            up. Below 2 cm/s it keeps its last direction; at the start of an episode that is the object's own x axis.
        entry_frames: The heading frames at the entry of this phase.
        grasp: The scene at the end of the last phase with `Phase.takes_hold`; None before.
        lead_time: Seconds of constant-velocity prediction; 0 for the prior, as in the paper.
    """

    state: SceneState
    entry: SceneState
    start: SceneState
    frames: Mapping[str, Pose]
    entry_frames: Mapping[str, Pose]
    grasp: SceneState | None = None
    lead_time: float = 0.0

    __repr__ = one_line

    def T_ee_grasped(self, name: str) -> Pose:  # noqa: N802 - named as poses are
        """Return the pose of an object in the hand as measured at the grasp, or as it is now if there was none."""
        grasp = self.grasp or self.state
        return grasp.ee.inverse() @ grasp.objects[name].pose


class ViewTracker:
    """Follows the scene through the phases of an episode, for the views that it offers.

    Args:
        start: The scene at t = 0, where the first phase is entered.
        lead_time: As in `PhaseView`.

    Attributes:
        frames: As in `PhaseView`.
    """

    def __init__(self, start: SceneState, *, lead_time: float = 0.0) -> None:
        self._state = self._start = start
        self._lead_time = lead_time
        self._grasp: SceneState | None = None
        self.frames: Mapping[str, Pose] = heading_frames(start, None)
        self.enter()

    def push(self, state: SceneState) -> None:
        """Take in the scene after a control step."""
        self._state = state
        self.frames = heading_frames(state, self.frames)

    def enter(self) -> None:
        """Note that a phase is entered with the latest scene."""
        self._entry, self._entry_frames = self._state, self.frames

    def take_hold(self) -> None:
        """Note that the latest scene shows the grasped object in the hand."""
        self._grasp = self._state

    def view(self) -> PhaseView:
        """Return the latest scene, as the running phase sees it."""
        return PhaseView(
            state=self._state,
            entry=self._entry,
            start=self._start,
            frames=self.frames,
            entry_frames=self._entry_frames,
            grasp=self._grasp,
            lead_time=self._lead_time,
        )


def heading_frames(state: SceneState, previous: Mapping[str, Pose] | None) -> dict[str, Pose]:
    """Return the heading frame of every object; `previous` are those of the last control step, None at the start."""
    return {
        name: heading_frame(body, None if previous is None else previous[name]) for name, body in state.objects.items()
    }


def heading_frame(body: BodyState, previous: Pose | None) -> Pose:
    """Return the heading frame of one object; `previous` is that of the last control step, None at the start."""
    if previous is not None and previous.position is body.pose.position:
        return previous  # something that cannot move, whose state is one and the same
    vx, vy, _ = body.velocity.tolist()
    if vx * vx + vy * vy > HEADING_SPEED**2:
        rotation = rotation_z(math.atan2(vy, vx))
    elif previous is not None:
        rotation = previous.rotation
    else:
        rotation = rotation_z(yaw(body.pose))
    return Pose(rotation, body.pose.position)


def yaw(pose: Pose) -> float:
    """Return the angle of a body's x axis in the horizontal plane, radians.

    Where the x axis is nearly vertical, it is the angle of the y axis less a quarter turn.
    """
    x, y, z = pose.rotation[:, 0].tolist()
    if abs(z) < 0.9:
        return math.atan2(y, x)
    x, y, _ = pose.rotation[:, 1].tolist()
    return math.atan2(y, x) - math.pi / 2
