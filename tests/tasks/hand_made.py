"""Scenes and views written by hand: one can, one hand, nothing simulated."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynaforge.geometry import Array, Pose
from dynaforge.sim import BodyState, SceneState
from dynaforge.sim.contacts import Contacts, Press
from dynaforge.tasks.targets import DOWN_ALONG_X, DOWN_ALONG_Y
from dynaforge.tasks.view import PhaseView, heading_frames

Point = tuple[float, float, float]
FIRM = Press(20.0, 20.0)


def contacts(
    touching: Mapping[str, tuple[bool, bool]],
    supports: tuple[tuple[str, str], ...] = (),
    *,
    press: Press = FIRM,
    **more: Mapping[str, float],
) -> Contacts:
    """Fingers that press firmly, toward each other, on what they touch, and bodies carried by others with 1 N."""
    fingers = {
        name: (press if left else Press(), press if right else Press()) for name, (left, right) in touching.items()
    }
    return Contacts(fingers=fingers, supports=dict.fromkeys(supports, 1.0), **more)


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
        contacts=contacts({"can": touching}),
    )


def body(
    position: Point,
    rotation: Array | None = None,
    velocity: Point = (0.0, 0.0, 0.0),
    angular_velocity: Point = (0.0, 0.0, 0.0),
) -> BodyState:
    """A body at a place, upright unless a rotation is given."""
    pose = Pose(np.eye(3) if rotation is None else rotation, np.array(position))
    return BodyState(pose, np.array(velocity), np.array(angular_velocity))


def scene_of(
    *,
    ee: Pose | None = None,
    width: float = 0.08,
    touching: Mapping[str, tuple[bool, bool]] | None = None,
    on_table: Mapping[str, bool] | None = None,
    pressed: Mapping[str, float] | None = None,
    **objects: BodyState,
) -> SceneState:
    """A scene with any bodies and fixtures; bodies that are not mentioned touch nothing."""
    return SceneState(
        time=0.0,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=ee or Pose(DOWN_ALONG_Y, np.array((0.5, 0.0, 0.3))),
        width=width,
        objects=objects,
        touching=dict.fromkeys(objects, (False, False)) | dict(touching or {}),
        on_table=dict.fromkeys(objects, False) | dict(on_table or {}),
        pressed=dict(pressed or {}),
        contacts=contacts(touching or {}),
    )


def view(
    state: SceneState,
    *,
    entry: SceneState | None = None,
    start: SceneState | None = None,
    grasp: SceneState | None = None,
    lead_time: float = 0.0,
) -> PhaseView:
    """Look at a scene from a phase entered at `entry` of an episode begun at `start`, both by default this scene."""
    entry, start = entry or state, start or state
    return PhaseView(
        state=state,
        entry=entry,
        start=start,
        frames=heading_frames(state, None),
        entry_frames=heading_frames(entry, None),
        grasp=grasp,
        lead_time=lead_time,
    )
