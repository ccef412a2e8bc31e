"""A dry run of a task at its making: what it launches, and what its words say of a scene that nobody simulated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim import BodyState, Condition, Launch, Placement, SceneState
from dynaforge.sim.robot import HAND_WIDTH
from dynaforge.tasks.targets import DOWN_ALONG_Y
from dynaforge.tasks.view import PhaseView, heading_frames
from dynaforge.tasks.words import aim, judge

if TYPE_CHECKING:
    from dynaforge.tasks.phase import Phase
    from dynaforge.tasks.predicates import Predicate
    from dynaforge.tasks.task import Task

# What a word may raise only because the scene is made up: a division by no distance, the root of a negative number.
OF_THE_SCENE = (ArithmeticError, ValueError, RuntimeWarning)
HAND = Pose(DOWN_ALONG_Y, np.array((0.45, 0.05, 0.25)))


def probe(task: Task) -> None:
    """Launch the ends and the middle of a task's conditions, and ask all its words about the start of one.

    Every word is asked twice, of an open hand that touches nothing and of a closed one that touches everything, since
    a predicate asks no further once it knows.

    Raises:
        ValueError: `launch` raises, forgets a body or names another; a word raises or returns something else than it
            should. Names the phase.
    """
    for condition in _conditions(task):
        starts = task.scene.starts(condition)
        for body in task.scene.bodies:
            start = starts[body.name]
            assert isinstance(start, Launch)
            body.check_launch(start)
    for view in _views(task, starts):
        for phase in task.phases:
            _ask_phase(phase, view)
        for reason, predicate in task.impossible:
            _ask("Task", f"impossible ({reason})", predicate, view, HAND)


def _ask_phase(phase: Phase, view: PhaseView) -> None:
    place, target = f"Phase {phase.name!r}", HAND
    try:
        target = aim(place, phase.target, view)
    except ValueError as error:
        if not isinstance(error.__cause__, OF_THE_SCENE):
            raise
    asked = [("done", phase.done), ("track_until", phase.track_until)]
    asked += [(f"fails ({reason})", predicate) for reason, predicate in phase.fails]
    for role, predicate in asked:
        if predicate is not None:
            _ask(place, role, predicate, view, target)


def _ask(place: str, role: str, predicate: Predicate, view: PhaseView, target: Pose) -> None:
    try:
        judge(place, role, predicate, view, target)
    except ValueError as error:
        if not isinstance(error.__cause__, OF_THE_SCENE):
            raise


def _conditions(task: Task) -> Iterator[Condition]:
    space = task.conditions
    for share in (0.0, 1.0, 0.5):
        values = {name: low + share * (high - low) for name, (low, high) in space.ranges.items()}
        yield Condition(task.name, 0, values[space.difficulty], values)


def _views(task: Task, starts: Mapping[str, Launch | Placement]) -> Iterator[PhaseView]:
    still = np.zeros(3)
    objects = {
        name: BodyState(start.pose, start.velocity, start.angular_velocity)
        if isinstance(start, Launch)
        else BodyState(start.pose, still, still)
        for name, start in starts.items()
    }
    for closed in (False, True):
        state = SceneState(
            time=0.0,
            q=np.zeros(7),
            dq=np.zeros(7),
            ee=HAND,
            width=0.0 if closed else HAND_WIDTH,
            objects=objects,
            touching=dict.fromkeys(objects, (closed, closed)),
            on_table={body.name: closed for body in task.scene.bodies},
            pressed={fixture.name: 0.0 for fixture in task.scene.fixtures if fixture.spring},
        )
        frames = heading_frames(state, None)
        yield PhaseView(state=state, entry=state, start=state, frames=frames, entry_frames=frames, grasp=state)
