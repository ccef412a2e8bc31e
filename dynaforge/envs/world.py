"""One control step of the whole stack: requested target -> joint reference -> physics, recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynaforge.envs.executor import PlannedAction
from dynaforge.envs.residual import gated, project, requested_target
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
from dynaforge.tasks import Task


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlStep:
    """All that is recorded of one control step.

    Attributes:
        before, after: The measured scene at its beginning and end.
        planned: a_plan of Eq. 5; None when an external policy acts.
        residual: The residual in physical units as applied (m * scale * a_res), shape (7,).
        requested: The target asked of the hand.
        reference: The joint reference that the limits left of it: the projection of Eq. 5.
    """

    before: SceneState
    after: SceneState
    planned: PlannedAction | None
    residual: Array
    requested: HandTarget
    reference: JointReference

    __repr__ = one_line


class World:
    """A task's scene with the planners that drive its robot.

    Args:
        task: What to simulate.
        visuals: Load visual shapes for rendering, as `SimScene` does.
        gui: Open Bullet's window.
    """

    def __init__(self, task: Task, *, visuals: Visuals = False, gui: bool = False) -> None:
        check_kind("task", task, Task)
        self.task = task
        self.scene = SimScene(task.scene, visuals=visuals, gui=gui)
        robot, dt = self.scene.robot, task.scene.control_dt
        self.kinematics = ArmKinematics(robot)
        self.local = LocalPlanner(robot, self.kinematics, dt=dt)
        self.follower = TargetFollower(robot, self.kinematics, dt=dt)
        self.planner = GlobalPlanner(robot, self.kinematics, CollisionModel(robot), dt=dt)
        self.listeners: list[Callable[[ControlStep], None]] = []
        self._no_residual = np.zeros(7)

    def reset(self, condition: Condition) -> SceneState:
        """Put scene and command at t = 0 of a condition.

        Raises:
            ValueError: It is not a condition of this task; nothing has changed then.
        """
        self.state = self.scene.reset(self.task.conditions.validate(condition))
        robot = self.scene.robot
        self.reference = self.local.reset(robot.q_ready, robot.width_max)
        self.follower.reset(robot.q_ready, robot.width_max)
        return self.state

    def execute(self, planned: PlannedAction, residual: Array | None) -> SceneState:
        """Execute Eq. 5 for one control step; `envs/residual.py` explains it.

        Args:
            planned: a_plan and m.
            residual: scale * a_res as `ResidualScale.physical` returns it, shape (7,); None for none.
        """
        residual = gated(residual, planned)
        requested = requested_target(planned, residual)
        reference = project(requested, planned, self.local)
        return self._step(reference, requested, planned, self._no_residual if residual is None else residual)

    def reach(self, target: HandTarget, *, elbow: float | None = None) -> SceneState:
        """Bring the hand to an absolute target in one control step.

        It gets there wherever the limits allow, and else as near as they do; `elbow` is the third joint's angle, rad.
        """
        return self._step(self.follower.reach(target, elbow=elbow), target, None, self._no_residual)

    def reach_joints(self, q: Array, width: float) -> SceneState:
        """Bring the joints to absolute targets (rad, shape (7,)) and the opening (m) in one control step, likewise."""
        reference = self.follower.reach_joints(q, width)
        return self._step(reference, HandTarget(self.kinematics.forward(q), width), None, self._no_residual)

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self.scene.close()

    def _step(
        self, reference: JointReference, requested: HandTarget, planned: PlannedAction | None, residual: Array
    ) -> SceneState:
        before = self.state
        self.reference = reference
        self.state = self.scene.step(reference.joints.q, reference.width)
        if self.listeners:
            record = ControlStep(
                before=before,
                after=self.state,
                planned=planned,
                residual=residual,
                requested=requested,
                reference=reference,
            )
            for listener in self.listeners:
                listener(record)
        return self.state
