"""A dry run of a task when it is made: its launch, and its targets and predicates on a scene that was not simulated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim import BodyState, Condition, Launch, Placement, SceneState
from dynaforge.sim.robot import HAND_WIDTH
from dynaforge.tasks.targets import DOWN_ALONG_Y
from dynaforge.tasks.view import PhaseView, heading_frames
from dynaforge.tasks.words import evaluate_predicate, evaluate_target

if TYPE_CHECKING:
    from dynaforge.tasks.phase import Phase
    from dynaforge.tasks.predicates import Predicate
    from dynaforge.tasks.task import Task

# What a word may raise only because the scene is made up: a division by no distance, the root of a negative number.
MADE_UP_SCENE_ERRORS = (ArithmeticError, ValueError, RuntimeWarning)
HAND = Pose(DOWN_ALONG_Y, np.array((0.45, 0.05, 0.25)))


def dry_run(task: Task) -> None:
    """Launch both ends and the middle of a task's conditions, and evaluate all its words at the start of the last.

    Every word is evaluated twice, with an open hand that touches nothing and with a closed hand that touches
    everything, because a predicate stops at the first part that decides it.

    Raises:
        ValueError: `launch` raises, omits a body or names one that the scene lacks; or a word raises or returns
            something of the wrong type. Names the phase.
    """
    for condition in _conditions(task):
        starts = task.scene.starts(condition)
        for body in task.scene.bodies:
            start = starts[body.name]
            assert isinstance(start, Launch)
            body.check_launch(start)
    for view in _views(task, starts):
        for phase in task.phases:
            _check_phase_words(phase, view)
        for reason, predicate in task.impossible:
            _check_word("Task", f"impossible ({reason})", predicate, view, HAND)


def _check_phase_words(phase: Phase, view: PhaseView) -> None:
    place, target = f"Phase {phase.name!r}", HAND
    try:
        target = evaluate_target(place, phase.target, view)
    except ValueError as error:
        if not isinstance(error.__cause__, MADE_UP_SCENE_ERRORS):
            raise
    predicates = [("done", phase.done), ("track_until", phase.track_until)]
    predicates += [("retry", phase.retry[1])] if phase.retry else []
    predicates += [(f"fails ({reason})", predicate) for reason, predicate in phase.fails]
    for role, predicate in predicates:
        if predicate is not None:
            _check_word(place, role, predicate, view, target)


def _check_word(place: str, role: str, predicate: Predicate, view: PhaseView, target: Pose) -> None:
    try:
        evaluate_predicate(place, role, predicate, view, target)
    except ValueError as error:
        if not isinstance(error.__cause__, MADE_UP_SCENE_ERRORS):
            raise


def _conditions(task: Task) -> Iterator[Condition]:
    space = task.conditions
    for share in (0.0, 1.0, 0.5):
        values = {name: low + share * (high - low) for name, (low, high) in space.ranges.items()}
        yield Condition(task.name, 0, values[space.difficulty], values)


def _views(task: Task, starts: Mapping[str, Launch | Placement]) -> Iterator[PhaseView]:
    objects = {name: _body_state(start) for name, start in starts.items()}
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


def _body_state(start: Launch | Placement) -> BodyState:
    if isinstance(start, Launch):
        return BodyState(start.pose, start.velocity, start.angular_velocity)
    return BodyState(start.pose, np.zeros(3), np.zeros(3))
