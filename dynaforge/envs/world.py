"""One control step of the whole stack: requested target -> IK and Ruckig -> physics, recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynaforge.envs.executor import PlannedAction
from dynaforge.geometry import Array, Pose, matrix_from_rotvec, one_line
from dynaforge.planning import (
    ArmKinematics,
    CollisionModel,
    GlobalPlanner,
    JointReference,
    LocalPlanner,
    TargetFollower,
)
from dynaforge.sim import Condition, SceneState, SimScene
from dynaforge.sim.camera import Visuals
from dynaforge.sim.checks import check_kind
from dynaforge.tasks import Task

LOWEST_EE = 0.012  # metres above the table: the finger tips are 7 mm below the end-effector frame


@dataclass(frozen=True, slots=True, eq=False)
class ControlStep:
    """All that is recorded of one control step.

    Attributes:
        before, after: The measured scene at its beginning and end.
        planned: a_plan of Eq. 5; None when an external policy acts.
        residual: The residual in physical units as applied (m * scale * a_res), shape (7,).
        requested, requested_width: The target asked of the arm: `T_world_ee`, and metres.
        reference: The joint reference that the limits left of it: the projection of Eq. 5.
    """

    before: SceneState
    after: SceneState
    planned: PlannedAction | None
    residual: Array
    requested: Pose
    requested_width: float
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
        """Execute Eq. 5 for one control step.

        Args:
            planned: a_plan.
            residual: Physical residual in the world frame, shape (7,): translation (m), rotation vector (rad), width
                (m); None for none.
        """
        if planned.sample is not None:
            s = planned.sample
            reference = self.local.follow(s.q, s.dq, s.ddq, planned.width)
            return self._step(reference, planned.target, planned.width, planned, self._no_residual)
        target, width = planned.target, planned.width
        if residual is not None:
            target, width = corrected(target, width, residual)
        reference = self.local.track(*self._inside(target, width))
        return self._step(reference, target, width, planned, self._no_residual if residual is None else residual)

    def reach(self, target: Pose, width: float, *, elbow: float | None = None) -> SceneState:
        """Bring the end effector to an absolute target `T_world_ee` and opening (m) in one control step.

        It gets there wherever the limits allow, and else as near as they do; `elbow` is the third joint's angle, rad.
        """
        reference = self.follower.reach(target, width, elbow=elbow)
        return self._step(reference, target, width, None, self._no_residual)

    def reach_joints(self, q: Array, width: float) -> SceneState:
        """Bring the joints to absolute targets (rad, shape (7,)) and the opening (m) in one control step, likewise."""
        reference = self.follower.reach_joints(q, width)
        return self._step(reference, self.kinematics.forward(q), width, None, self._no_residual)

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self.scene.close()

    def _inside(self, target: Pose, width: float) -> tuple[Pose, float]:
        if target.position[2] < LOWEST_EE:
            x, y, _ = target.position.tolist()
            target = Pose(target.rotation, np.array((x, y, LOWEST_EE)))
        return target, min(max(width, 0.0), self.scene.robot.width_max)

    def _step(
        self, reference: JointReference, target: Pose, width: float, planned: PlannedAction | None, residual: Array
    ) -> SceneState:
        before = self.state
        self.reference = reference
        self.state = self.scene.step(reference.q, reference.width)
        if self.listeners:
            record = ControlStep(before, self.state, planned, residual, target, width, reference)
            for listener in self.listeners:
                listener(record)
        return self.state


def corrected(target: Pose, width: float, residual: Array) -> tuple[Pose, float]:
    """Add a world-frame residual, shape (7,), to a target before IK (Eq. 5 without its projection)."""
    rotation = target.rotation
    if residual[3] or residual[4] or residual[5]:
        rotation = matrix_from_rotvec(residual[3:6]) @ rotation
    return Pose(rotation, target.position + residual[:3]), width + float(residual[6])
