"""Whether what must be true has been true for long enough: the end of a phase, and a task's success."""

from __future__ import annotations

from dynaforge.sim import SceneState
from dynaforge.tasks.phase import Phase
from dynaforge.tasks.task import Task
from dynaforge.tasks.view import PhaseView, heading_frames
from dynaforge.tasks.words import evaluate_predicate


class Hold:
    """Counts the consecutive control steps at which a phase's `done` was true.

    Args:
        phase: The phase.
        control_dt: Duration of a control step, seconds.
    """

    def __init__(self, phase: Phase, *, control_dt: float) -> None:
        self._phase = phase
        self._dt = control_dt
        self._steps = 0

    def push(self, done: bool) -> bool:
        """Count a control step after which `done` was true or not; return whether it has held for `Phase.hold`."""
        self._steps = self._steps + 1 if done else 0
        return self._phase.is_held(self._steps, self._dt)


class SuccessJudge:
    """Judges a task's success from the states alone, independently of what moves the arm.

    Args:
        task: The task.
        start: The scene at t = 0.

    Attributes:
        view: The latest scene, as predicates read it.
    """

    def __init__(self, task: Task, start: SceneState) -> None:
        self._last = task.phases[-1]
        self._place = f"Phase {self._last.name!r}"
        self._hold = Hold(self._last, control_dt=task.scene.control_dt)
        frames = heading_frames(start, None)
        self.view = PhaseView(state=start, entry=start, start=start, frames=frames, entry_frames=frames)

    def push(self, state: SceneState) -> bool:
        """Take in the scene after a control step; return whether the last phase's `done` has held long enough."""
        frames, start = heading_frames(state, self.view.frames), self.view.start
        self.view = PhaseView(state=state, entry=start, start=start, frames=frames, entry_frames=frames)
        return self._hold.push(evaluate_predicate(self._place, "done", self._last.done, self.view, state.ee))
