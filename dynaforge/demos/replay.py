"""Replay of an episode: the same condition and the same joint references must give the same states, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaforge.demos.episode import Episode
from dynaforge.demos.prescription import motion_of
from dynaforge.sim import SceneState, SimScene
from dynaforge.sim.camera import Visuals
from dynaforge.sim.delays import DelayLine, Delays
from dynaforge.sim.loads import Loads
from dynaforge.tasks import Task
from dynaforge.tasks.success import SuccessJudge


@dataclass(frozen=True, slots=True)
class Divergence:
    """Where a replay first left the recording.

    Attributes:
        step: Index of the control step.
        quantity: Its name in the schema.
        difference: Largest absolute difference of its components.
    """

    step: int
    quantity: str
    difference: float

    def __str__(self) -> str:
        return f"{self.quantity} differs from step {self.step} on, by {self.difference:.3g}"


@dataclass(frozen=True, slots=True)
class Replay:
    """What a replay found.

    Attributes:
        divergence: Where it first left the recording; None when every bit agrees.
        success: Whether the task's success predicate had been true for the required time at the end.
        loads: The greatest external loads on the robot.
    """

    divergence: Divergence | None
    success: bool
    loads: Loads


class Replayer:
    """Simulates recorded joint references in a scene of its own; use one for many episodes of a task.

    Args:
        task: The task of the episodes, in the setting in which they were recorded.
        visuals: Which visual shapes to load, as in `SimScene`; physics does not depend on it.
    """

    def __init__(self, task: Task, *, visuals: Visuals = False) -> None:
        self.task = task
        self.scene = SimScene(task.simulated, reflex=task.setting.reflex, visuals=visuals)

    def replay(self, episode: Episode) -> Replay:
        """Simulate an episode again and compare every recorded state.

        Raises:
            ValueError: The condition is not one of the task, or no joint references were recorded.
        """
        states = self.states(episode)
        start = next(states)
        judge, success = SuccessJudge(self.task, start), False
        divergence = first_difference(episode, 0, start)
        for step, state in enumerate(states, 1):
            divergence = divergence or first_difference(episode, step, state)
            success = judge.push(state)
        return Replay(divergence, success, self.scene.loads)

    def states(self, episode: Episode) -> Iterator[SceneState]:
        """Simulate an episode again and yield the state at the beginning of each step, and the one after the last.

        `scene` is in the state that was yielded last.

        Raises:
            ValueError: As for `replay`.
        """
        references = [episode.steps.get(name) for name in ("joint_reference", "width_reference")]
        if len(episode) and any(column is None for column in references):
            raise ValueError(f"Episode {episode.id} records no joint references, so it cannot be replayed.")
        yield self.scene.reset(self.task.conditions.validate(episode.condition), prescribed=motion_of(episode))
        robot, late = self.scene.robot, Delays.drawn_by(episode.condition, self.task.setting.sensing).action
        commands = DelayLine([(robot.q_ready, robot.width_max)] * late)
        gates = episode.steps.get("gate", ())
        first_gate = int(np.argmax(gates)) if np.any(gates) else None
        for step, (q, width) in enumerate(zip(*references, strict=True) if len(episode) else ()):
            if step == first_gate:
                self.scene.renew_contacts()  # as `World.execute` does
            yield self.scene.step(*commands.push((np.array(q), float(width))))

    def recorded_states(self, episode: Episode) -> Iterator[SceneState]:
        """Simulate an episode again and yield the state at the beginning of each step, once it is compared.

        `scene` is in the state that was yielded last.

        Raises:
            ValueError: As for `replay`, or a state differs from the recording.
        """
        for step, state in zip(range(len(episode)), self.states(episode), strict=False):
            if divergence := first_difference(episode, step, state):
                raise ValueError(f"Episode {episode.id} cannot be simulated again: {divergence}.")
            yield state

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self.scene.close()


def first_difference(episode: Episode, step: int, state: SceneState) -> Divergence | None:
    """Compare a state with a recording.

    Args:
        episode: The recording.
        step: Index of the control step that begins with this state.
        state: The simulated state.

    Returns:
        The first quantity that differs; None where all agree, and after the last step.
    """
    if step >= len(episode):
        return None
    for name, value in _measured(state):
        recorded = episode.steps.get(name)
        if recorded is not None and not np.array_equal(recorded[step], value):
            return Divergence(step, name, float(np.abs(np.asarray(recorded[step]) - value).max()))
    return None


def _measured(state: SceneState) -> Iterator[tuple[str, Any]]:
    yield "time", state.time
    yield "q", state.q
    yield "dq", state.dq
    yield "ee_position", state.ee.position
    yield "ee_quat_wxyz", state.ee.quat_wxyz
    yield "width", state.width
    yield "peak_force", state.loads.peak_force
    for name, body in state.objects.items():
        columns = body.columns
        for kind in ("object", "fixture"):
            yield from ((f"{kind}/{name}/{column}", value) for column, value in columns.items())
