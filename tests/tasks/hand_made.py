"""Scenes and views written by hand: one can, one hand, nothing simulated."""

from __future__ import annotations

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim import BodyState, SceneState
from dynaforge.tasks.targets import DOWN_ALONG_X
from dynaforge.tasks.view import PhaseView, heading_frames

Point = tuple[float, float, float]


def scene(
    can: Point = (0.5, 0.0, 0.033),
    velocity: Point = (0.0, 0.0, 0.0),
    *,
    hand: Point = (0.5, 0.0, 0.2),
    touching: tuple[bool, bool] = (False, False),
    time: float = 0.0,
) -> SceneState:
    """A can at a place with a velocity, a hand that points straight down, and who touches whom."""
    body = BodyState(Pose(np.eye(3), np.array(can)), np.array(velocity), np.zeros(3))
    return SceneState(
        time=time,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=Pose(DOWN_ALONG_X, np.array(hand)),
        width=0.08,
        objects={"can": body},
        touching={"can": touching},
        on_table={"can": can[2] < 0.04},
    )


def view(
    state: SceneState, *, entry: SceneState | None = None, start: SceneState | None = None, lead_time: float = 0.0
) -> PhaseView:
    """Look at a scene from a phase entered at `entry` of an episode begun at `start`, both by default this scene."""
    entry, start = entry or state, start or state
    return PhaseView(state, entry, start, heading_frames(state, None), heading_frames(entry, None), lead_time=lead_time)
