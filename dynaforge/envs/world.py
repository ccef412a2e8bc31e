"""One control step of the whole stack: from a requested target to a joint reference and through physics, recorded."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from dynaforge.envs.executor import PlannedAction
from dynaforge.envs.residual import gated, project, requested_target
from dynaforge.envs.sensing import Sensor
from dynaforge.geometry import Array, one_line
from dynaforge.planning import (
    ArmKinematics,
    CollisionModel,
    GlobalPlanner,
    JointReference,
    LocalPlanner,
    TargetFollower,
)
from dynaforge.sim import Condition, HandTarget, SceneState, SimScene
from dynaforge.sim.camera import Visuals
from dynaforge.sim.checks import check_kind
from dynaforge.sim.delays import DelayLine, Delays
from dynaforge.sim.prescribed import PrescribedMotion
from dynaforge.sim.snapshot import put_back, remember
from dynaforge.tasks import Task


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlStep:
    """All that is recorded of one control step.

    Attributes:
        before: The true scene at its beginning.
        after: The true scene at its end.
        sensed: The scene at its beginning as planner and policy saw it; with ideal sensing it is `before`.
        planned: a_plan of Eq. 5; None when an external policy acts.
        residual: The residual in physical units as applied (m * scale * a_res), shape (7,).
        requested: The target requested of the hand.
        reference: The joint reference that the limits allow, the projection of Eq. 5. With real sensing, it reaches
            the robot up to one control step later.
    """

    before: SceneState
    after: SceneState
    sensed: SceneState
    planned: PlannedAction | None
    residual: Array
    requested: HandTarget
    reference: JointReference

    __repr__ = one_line


class World:
    """A task's scene with the planners that drive its robot, and what they and a policy see of it.

    Args:
        task: The task. Its setting says what stops the robot, and what is sensed. "ideal": planner and policy see the
            truth at once. "real": late and blurred (`envs.sensing`), and commands reach the robot late.
        visuals: Which visual shapes to load for rendering, as in `SimScene`.
        gui: Whether to open Bullet's window.

    Attributes:
        state: The true scene now; what is judged.
        sensed: The scene as planner and policy see it; with ideal sensing it is `state`.
        listeners: Called after every control step.
        keeps_gate: Whether the world is saved when the first gate opens, so that `restore` can go
            back there. The bits of an episode are the same in either case.
    """

    def __init__(self, task: Task, *, visuals: Visuals = False, gui: bool = False) -> None:
        check_kind("task", task, Task)
        self.task = task
        self.scene = SimScene(task.simulated, reflex=task.setting.reflex, visuals=visuals, gui=gui)
        robot, dt = self.scene.robot, task.scene.control_dt
        self.kinematics = ArmKinematics(robot)
        self.local = LocalPlanner(robot, self.kinematics, dt=dt)
        self.follower = TargetFollower(robot, self.kinematics, dt=dt)
        self.planner = GlobalPlanner(robot, self.kinematics, CollisionModel(robot), dt=dt)
        self.listeners: list[Callable[[ControlStep], None]] = []
        self._no_residual = np.zeros(7)
        self._saved: object | None = None
        self.keeps_gate = False
        self._sensor = Sensor(dt) if task.setting.sensing == "real" else None

    def reset(self, condition: Condition, *, prescribed: PrescribedMotion | None = None) -> SceneState:
        """Reset the scene and the joint reference to t = 0 of a condition.

        Args:
            condition: The condition.
            prescribed: As in `SimScene.reset`.

        Raises:
            ValueError: It is not a condition of this task, in which case nothing has changed.
        """
        self.state = self.scene.reset(self.task.conditions.validate(condition), prescribed=prescribed)
        robot = self.scene.robot
        self.reference = self.local.reset(robot.q_ready, robot.width_max)
        self.follower.reset(robot.q_ready, robot.width_max)
        late = Delays.drawn_by(condition, self.task.setting.sensing).action
        self._commands = DelayLine([self.reference] * late)
        self._gate_opened = False
        self.sensed = self._sensor.reset(self.state, condition) if self._sensor is not None else self.state
        return self.state

    @property
    def first_gate(self) -> SceneState | None:
        """The scene at the first gate of the latest condition, to which `restore` goes back; None if not saved."""
        return self._first_gate if self.scene.saved is not None and self.scene.saved is self._saved else None

    def restore(self) -> None:
        """Go back to `first_gate`, from which the same actions give the same bits every time.

        Real sensing is not taken back: its draws and what it remembers go on.

        Raises:
            RuntimeError: No gate has opened in this condition, or none was saved.
        """
        self.scene.restore()
        put_back([*self._memory, (self, self._own)])
        self.local.restore(self.reference)

    def _open_gate(self) -> None:
        """End Bullet's contact caches, as every episode does here, and save the world if anybody may go back."""
        self._gate_opened = True
        self.local.restore(self.reference)
        if not self.keeps_gate:
            self.scene.renew_contacts()
            return
        self.scene.save()
        self._saved, self._first_gate = self.scene.saved, self.state
        # Its own part is named apart, since a world that referred to itself would stay until garbage is collected.
        self._own = {name: getattr(self, name) for name in ("state", "sensed", "reference", "_gate_opened")}
        self._memory = remember(self.follower, self._commands)

    def execute(self, planned: PlannedAction, residual: Array | None) -> SceneState:
        """Apply Eq. 5 for one control step; `envs/residual.py` explains it.

        Args:
            planned: a_plan and m.
            residual: scale * a_res as `ResidualScale.physical` returns it, shape (7,); None for a residual of zero.
        """
        if planned.gate and not self._gate_opened:
            self._open_gate()
        residual = gated(residual, planned)
        requested = requested_target(planned, residual)
        reference = project(requested, planned, self.local)
        return self._step(reference, requested, planned, self._no_residual if residual is None else residual)

    def reach(self, target: HandTarget, *, elbow: float | None = None) -> SceneState:
        """Move the hand to an absolute target in one control step, or as near to it as the limits allow.

        Args:
            target: Pose and width.
            elbow: Angle of the third joint, rad; None for any.
        """
        return self._step(self.follower.reach(target, elbow=elbow), target, None, self._no_residual)

    def reach_joints(self, q: Array, width: float) -> SceneState:
        """Move the joints to absolute targets in one control step, or as near to them as the limits allow.

        Args:
            q: Joint positions, rad, shape (7,).
            width: Opening of the fingers, m.
        """
        reference = self.follower.reach_joints(q, width)
        return self._step(reference, HandTarget(self.kinematics.forward(q), width), None, self._no_residual)

    @contextlib.contextmanager
    def listening(self, listener: Callable[[ControlStep], None]) -> Iterator[None]:
        """Call a listener after every control step that is made in the block.

        Args:
            listener: Takes the control step.
        """
        self.listeners.append(listener)
        try:
            yield
        finally:
            self.listeners.remove(listener)

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self.scene.close()

    def _step(
        self, reference: JointReference, requested: HandTarget, planned: PlannedAction | None, residual: Array
    ) -> SceneState:
        before, sensed = self.state, self.sensed
        self.reference = reference
        arrived = self._commands.push(reference)
        self.state = self.scene.step(arrived.joints.q, arrived.width)
        self.sensed = self._sensor.push(self.state) if self._sensor is not None else self.state
        if self.listeners:
            record = ControlStep(
                before=before,
                after=self.state,
                sensed=sensed,
                planned=planned,
                residual=residual,
                requested=requested,
                reference=reference,
            )
            for listener in self.listeners:
                listener(record)
        return self.state
