"""The phase program of a task at work: which phase runs, with which target and gate, and how the episode ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynaforge.envs.ramp import Ramp
from dynaforge.geometry import JointState, JointTrajectory, Pose, one_line
from dynaforge.planning import GlobalPlanner, JointReference, PlanFailure
from dynaforge.sim import Condition, HandTarget, SceneState
from dynaforge.sim.hand_target import raised_to
from dynaforge.sim.snapshot import Memory, remember
from dynaforge.tasks import Mode, Outcome, Phase, Task
from dynaforge.tasks.predicates import Predicate
from dynaforge.tasks.success import Hold
from dynaforge.tasks.view import PhaseView, ViewTracker
from dynaforge.tasks.words import evaluate_predicate, evaluate_target

TRAILING = 2  # control steps by which the hand trails its target


@dataclass(frozen=True, slots=True, eq=False)
class PlannedAction:
    """a_plan of Eq. 5 for one control step.

    Attributes:
        target: Desired pose of the end effector and opening of the fingers.
        gate: m of Eq. 5.
        phase: Index of the running phase.
        sample: In a global phase, the sample of the trajectory, which is followed as it is; else None, and inverse
            kinematics tracks `target`.
        lowest: Least height of the end effector in the world, metres, to which the projection raises what is requested.
    """

    target: HandTarget
    gate: bool
    phase: int
    sample: JointState | None
    lowest: float = -math.inf

    __repr__ = one_line


class PhaseExecutor:
    """Advances through the phase program and plans the next control step.

    Call `reset` once per episode and `advance` after every control step; then either `outcome` is set, or `action` is
    the plan for the next control step.

    Args:
        task: The task whose program runs.
        planner: The planner for phases of mode "global".
        control_dt: Duration of a control step, seconds.
    """

    action: PlannedAction

    def __init__(self, task: Task, planner: GlobalPlanner, *, control_dt: float) -> None:
        self.task = task
        self._planner = planner
        self._dt = control_dt
        self._steps = 0  # since the entry of the running phase

    def reset(
        self,
        state: SceneState,
        condition: Condition,
        reference: JointReference,
        *,
        sensed: SceneState | None = None,
        first: int = 0,
    ) -> None:
        """Enter the first phase.

        Args:
            state: The scene at t = 0, or when the phase is entered.
            condition: The condition of the episode.
            reference: The joint reference; a global plan starts from it.
            sensed: The scene as targets see it; None where that is the truth.
            first: Index of the phase to enter, where something else has brought the arm through those before.
        """
        self.outcome: Outcome | None = None
        self._seed = condition.seed
        self._steps = 0
        self._spent = [0] * len(self.task.phases)  # control steps in each phase, in all its visits
        self._checkpoint = 0
        self._true = ViewTracker(state, lead_time=self.task.lead_time)
        self._seen = self._true
        if sensed is not None and sensed is not state:
            self._seen = ViewTracker(sensed, lead_time=self.task.lead_time)
        self._enter(first, reference)

    def memory(self) -> Memory:
        """Return all that changes during an episode, for `put_back`."""
        return remember(self, self._hold, self._true, self._seen)

    def advance(self, state: SceneState, reference: JointReference, *, sensed: SceneState | None = None) -> None:
        """Evaluate the predicates on the true state, then plan the next control step on the sensed one, or end.

        Args:
            state: The scene after the control step.
            reference: The joint reference; a global plan starts from it.
            sensed: The scene as targets see it; None where that is the truth, which is decided at the reset.
        """
        self._true.push(state)
        if self._seen is not self._true:
            assert sensed is not None, "the reset was given a sensed scene, this control step was not"
            self._seen.push(sensed)
        self._steps += 1
        self._spent[self.index] += 1
        view, phase = self._true.view(), self.phase
        for reason, impossible in self._endings:
            if self._holds(reason, impossible, view):
                return self._fail(reason)
        if self._hold.push(self._holds("done", phase.done, view)):
            if phase.takes_hold:
                self._true.take_hold()
                self._seen.take_hold()
            if self.index + 1 == len(self.task.phases):
                return self._end()
            return self._enter(self.index + 1, reference)
        if self._spent[self.index] * self._dt >= phase.timeout - 1e-9:
            return self._fail(phase.failure)
        if phase.retry is not None and self._holds("retry", phase.retry[1], view):
            names = [each.name for each in self.task.phases]
            return self._enter(names.index(phase.retry[0]), reference)
        self._plan(view)
        return None

    @property
    def phase(self) -> Phase:
        """The running phase."""
        return self.task.phases[self.index]

    @property
    def phase_time_left(self) -> float:
        """Fraction of the running phase's timeout that is left, in [0, 1]."""
        return 1.0 - self._spent[self.index] * self._dt / self.phase.timeout

    @property
    def frame(self) -> Pose:
        """Heading frame `T_world_heading` of the running phase's object, as sensed."""
        return self._seen.frames[self.phase.target.object]

    @property
    def frozen(self) -> bool:
        """Whether the target no longer follows the object."""
        return self._frozen

    def _enter(self, index: int, reference: JointReference) -> None:
        speed = self.task.phases[index].ramp
        left = None if speed is None or not self._steps else self._now()
        self.index, self._checkpoint = index, max(self._checkpoint, index)
        self._endings = (*self.phase.fails, *self.task.endings)
        self._place = f"Phase {self.phase.name!r}"  # which the message of a mistake in one of its words begins with
        self._steps = 0
        self._hold = Hold(self.phase, control_dt=self._dt)
        self._true.enter()
        self._seen.enter()
        self._trajectory: JointTrajectory | None = None
        self._frozen = False
        self._ramp: Ramp | None = None
        view = self._true.view()
        if speed is not None and left is not None:
            self._ramp = Ramp.between(left, self._aim(self._seen.view()), self.frame, speed)
        if self.phase.mode is Mode.GLOBAL:
            self._target = self._aim(self._seen.view())
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
        seen = view if self._seen is self._true else self._seen.view()
        lowest = self._lowest(seen)
        if self._trajectory is not None:
            sample = self._trajectory[min(self._steps + 1, len(self._trajectory) - 1)]
        elif not self._frozen:
            self._target = raised_to(self._wanted(seen), lowest)
            until = phase.track_until
            self._frozen = until is not None and self._holds("track_until", until, view)
        target = self._ramped(self._target, self._steps + 1)
        if phase.ramp is not None:  # waits for a hand that trails: it would dive after a target that is far below
            target = raised_to(target, float(seen.state.ee.position[2]) - phase.ramp * TRAILING * self._dt)
        self.action = PlannedAction(HandTarget(target, phase.width), phase.gate, self.index, sample, lowest)

    def _now(self) -> Pose:
        """Return where the running phase wants the hand now, at the end of a control step."""
        settled = self._frozen or self._trajectory is not None
        return self._ramped(self._target if settled else self._aim(self._seen.view()), self._steps)

    def _ramped(self, target: Pose, steps: int) -> Pose:
        return target if self._ramp is None else self._ramp.applied(target, self.frame, steps * self._dt)

    def _holds(self, role: str, predicate: Predicate, view: PhaseView) -> bool:
        return evaluate_predicate(self._place, role, predicate, view, self._target)

    def _aim(self, seen: PhaseView) -> Pose:
        return raised_to(self._wanted(seen), self._lowest(seen))

    def _wanted(self, seen: PhaseView) -> Pose:
        return evaluate_target(self._place, self.phase.target, seen)

    def _lowest(self, seen: PhaseView) -> float:
        """Return the least height of the end effector in the world, metres."""
        lowest, name = self.phase.lowest, self.phase.target.object
        return -math.inf if lowest is None else lowest + float(seen.state.objects[name].pose.position[2])

    def _fail(self, reason: str) -> None:
        self._end(failure=reason)

    def _end(self, *, failure: str = "") -> None:
        self.outcome = Outcome(
            success=not failure,
            checkpoint=self._checkpoint if failure else self.task.n_checkpoints,
            n_checkpoints=self.task.n_checkpoints,
            failure=failure,
            phase=self.phase.name,
        )
