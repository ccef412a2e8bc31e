"""The phase program of a task at work: which phase runs, with which target and gate, and how the episode ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaforge.geometry import JointState, JointTrajectory, Pose, one_line
from dynaforge.planning import GlobalPlanner, JointReference, PlanFailure
from dynaforge.sim import Condition, HandTarget, SceneState
from dynaforge.tasks import Mode, Outcome, Phase, Task
from dynaforge.tasks.predicates import Predicate
from dynaforge.tasks.success import Hold
from dynaforge.tasks.view import PhaseView, heading_frames
from dynaforge.tasks.words import evaluate_predicate, evaluate_target


@dataclass(frozen=True, slots=True, eq=False)
class PlannedAction:
    """a_plan of Eq. 5 for one control step.

    Attributes:
        target: Desired pose of the end effector and opening of the fingers.
        gate: m of Eq. 5.
        phase: Index of the running phase.
        sample: In a global phase, the sample of the trajectory, which is followed as it is; else None, and inverse
            kinematics tracks `target`.
    """

    target: HandTarget
    gate: bool
    phase: int
    sample: JointState | None

    __repr__ = one_line


class PhaseExecutor:
    """Advances through the phase program and plans the next control step.

    Call `reset` once per episode and `advance` after every control step; then either `outcome` is set, or `action` is
    the plan for the next control step.

    Args:
        task: The task whose program runs.
        planner: The planner for phases of mode "global".
        control_dt: Duration of a control step, seconds.
        lead_time: Seconds of constant-velocity prediction; the paper's prior has none.
    """

    action: PlannedAction

    def __init__(self, task: Task, planner: GlobalPlanner, *, control_dt: float, lead_time: float = 0.0) -> None:
        self.task = task
        self._planner = planner
        self._dt = control_dt
        self._lead_time = lead_time
        self._steps = 0

    def reset(self, state: SceneState, condition: Condition, reference: JointReference) -> None:
        """Enter the first phase.

        Args:
            state: The scene at t = 0.
            condition: The condition of the episode.
            reference: The joint reference; a global plan starts from it.
        """
        self.outcome: Outcome | None = None
        self._seed = condition.seed
        self._start = state
        self._grasp: SceneState | None = None
        self._frames = heading_frames(state, None)
        self._enter(0, state, reference)

    def advance(self, state: SceneState, reference: JointReference) -> None:
        """Evaluate the predicates on the measured state, then plan the next control step or end the episode.

        Args:
            state: The scene after the control step.
            reference: The joint reference; a global plan starts from it.
        """
        self._frames = heading_frames(state, self._frames)
        self._steps += 1
        view = self._view(state)
        phase = self.phase
        for reason, impossible in (*phase.fails, *self.task.endings):
            if self._holds(reason, impossible, view, self.action.target.pose):
                return self._fail(reason)
        if self._hold.push(self._holds("done", phase.done, view, self.action.target.pose)):
            if phase.takes_hold:
                self._grasp = state
            if self.index + 1 == len(self.task.phases):
                return self._end(checkpoint=self.task.n_checkpoints)
            return self._enter(self.index + 1, state, reference)
        if self._steps * self._dt >= phase.timeout - 1e-9:
            return self._fail(phase.failure)
        self._plan(view)
        return None

    @property
    def phase(self) -> Phase:
        """The running phase."""
        return self.task.phases[self.index]

    @property
    def phase_time_left(self) -> float:
        """Fraction of the running phase's timeout that is left, in [0, 1]."""
        return 1.0 - self._steps * self._dt / self.phase.timeout

    @property
    def frame(self) -> Pose:
        """Heading frame `T_world_heading` of the running phase's object."""
        return self._frames[self.phase.target.object]

    @property
    def frozen(self) -> bool:
        """Whether the target no longer follows the object."""
        return self._frozen

    def _enter(self, index: int, state: SceneState, reference: JointReference) -> None:
        self.index = index
        self._place = f"Phase {self.phase.name!r}"  # which the message of a mistake in one of its words begins with
        self._steps = 0
        self._hold = Hold(self.phase, control_dt=self._dt)
        self._entry, self._entry_frames = state, self._frames
        self._trajectory: JointTrajectory | None = None
        self._frozen = False
        view = self._view(state)
        if self.phase.mode is Mode.GLOBAL:
            self._target = self._aim(view)
            try:
                rng = np.random.default_rng((self._seed, index))
                self._trajectory = self._planner.plan(reference.joints, self._target, rng=rng)
            except PlanFailure as failure:
                self._plan(view)  # so that the last observation shows this phase and target
                return self._fail(f"plan failed: {failure.reason}")
        self._plan(view)
        return None

    def _plan(self, view: PhaseView) -> None:
        phase, sample = self.phase, None
        if self._trajectory is not None:
            sample = self._trajectory[min(self._steps + 1, len(self._trajectory) - 1)]
        elif not self._frozen:
            self._target = self._aim(view)
            until = phase.track_until
            self._frozen = until is not None and self._holds("track_until", until, view, self._target)
        self.action = PlannedAction(HandTarget(self._target, phase.width), phase.gate, self.index, sample)

    def _holds(self, role: str, predicate: Predicate, view: PhaseView, target: Pose) -> bool:
        return evaluate_predicate(self._place, role, predicate, view, target)

    def _aim(self, view: PhaseView) -> Pose:
        return evaluate_target(self._place, self.phase.target, view)

    def _view(self, state: SceneState) -> PhaseView:
        return PhaseView(
            state=state,
            entry=self._entry,
            start=self._start,
            frames=self._frames,
            entry_frames=self._entry_frames,
            grasp=self._grasp,
            lead_time=self._lead_time,
        )

    def _fail(self, reason: str) -> None:
        self._end(checkpoint=self.index, failure=reason)

    def _end(self, *, checkpoint: int, failure: str = "") -> None:
        self.outcome = Outcome(
            success=not failure,
            checkpoint=checkpoint,
            n_checkpoints=self.task.n_checkpoints,
            failure=failure,
            phase=self.phase.name,
        )
