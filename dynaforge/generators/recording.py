"""Recording of the control steps of an episode, as the arrays of an `Episode`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.envs.world import ControlStep
from dynaforge.planning import ArmKinematics
from dynaforge.sim import HandTarget, SceneState
from dynaforge.sim.state import BODY_COLUMNS
from dynaforge.tasks import Task


class Recorder:
    """A listener of `World` that keeps every control step until `arrays` turns them into columns.

    Args:
        task: The task.
        kinematics: Kinematics of the arm, for the pose of the hand that the joint references give.
    """

    def __init__(self, task: Task, kinematics: ArmKinematics) -> None:
        self._task = task
        self._kinematics = kinematics
        self._steps: list[ControlStep] = []

    def __call__(self, step: ControlStep) -> None:
        self._steps.append(step)

    def clear(self) -> None:
        """Discard what was recorded."""
        self._steps.clear()

    def arrays(self, final_reward: float) -> dict[str, NDArray[Any]]:
        """Return one array per quantity, leading dimension T; empty when nothing was recorded.

        Args:
            final_reward: R of Eq. 6, the reward of the last step.
        """
        steps = self._steps
        if not steps:
            return {}
        before = [s.before for s in steps]
        columns = measured(before, self._task) | {
            "residual_action": [s.residual for s in steps],
            "requested_action": [s.requested.flat() for s in steps],
            "projected_action": [
                HandTarget(self._kinematics.forward(s.reference.joints.q), s.reference.width).flat() for s in steps
            ],
            "joint_reference": [s.reference.joints.q for s in steps],
            "joint_velocity_reference": [s.reference.joints.dq for s in steps],
            "width_reference": [s.reference.width for s in steps],
            "reward": [0.0] * (len(steps) - 1) + [final_reward],
        }
        if any(s.sensed is not s.before for s in steps):
            columns |= _sensed([s.sensed for s in steps])
        planned = [s.planned for s in steps if s.planned is not None]
        if planned:
            columns |= {
                "phase": np.array([action.phase for action in planned], dtype=np.int16),
                "gate": [action.gate for action in planned],
                "planner_action": [action.target.flat() for action in planned],
            }
        return {name: np.asarray(column) for name, column in columns.items()}


def _sensed(states: Sequence[SceneState]) -> dict[str, Any]:
    """Return the columns of scenes as planner and policy saw them."""
    columns = _robot(states)
    for name in states[0].objects:
        columns |= _body(states, name, prefix=name)
    return {f"sensed/{name}": column for name, column in columns.items()}


def measured(states: Sequence[SceneState], task: Task) -> dict[str, Any]:
    """Return the measured quantities of states, one column per quantity, named as in `demos.schema`."""
    contacts = [s.touching[task.manipulated] for s in states]
    columns: dict[str, Any] = {
        "time": [s.time for s in states],
        **_robot(states),
        "peak_force": [s.loads.peak_force for s in states],
        "left_contact": [left for left, _ in contacts],
        "right_contact": [right for _, right in contacts],
    }
    free = {body.name for body in task.scene.bodies}
    for name in states[0].objects:
        columns |= _body(states, name, prefix=f"{'object' if name in free else 'fixture'}/{name}")
    return columns


def _robot(states: Sequence[SceneState]) -> dict[str, Any]:
    """Return the columns of the robot."""
    return {
        "q": [s.q for s in states],
        "dq": [s.dq for s in states],
        "ee_position": [s.ee.position for s in states],
        "ee_quat_wxyz": [s.ee.quat_wxyz for s in states],
        "width": [s.width for s in states],
    }


def _body(states: Sequence[SceneState], name: str, *, prefix: str) -> dict[str, Any]:
    """Return the columns of a body, whose names begin with a prefix."""
    bodies = [s.objects[name].columns for s in states]
    return {f"{prefix}/{column}": [body[column] for body in bodies] for column in BODY_COLUMNS}
