"""The observation of the residual policy: a short history of privileged states, and a_plan, scaled to order one."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.envs.executor import PhaseExecutor
from dynaforge.geometry import Array, rotvec_from_matrix
from dynaforge.sim import RobotDescription, SceneState
from dynaforge.tasks import Task

LIMIT = 10.0  # to which scaled features are clipped

# For each tracked body where a task has several, such as the grasped object and the place where it belongs.
_PER_BODY = (("from_ee", 3, 0.2), ("velocity", 3, 1.0), ("axis", 3, 1.0))
_PER_STEP = (("ee_from_object", 3, 0.1), ("object_velocity", 3, 1.0), ("width", 1, 0.08), ("touching", 2, 1.0))


class ObservationBuilder:
    """Builds h_t and a_plan of Eq. 4 as one float32 vector.

    Vectors are expressed in the heading frame of the phase's object, so that "ahead" means the same whichever way it
    moves. Every feature is divided by a fixed scale; there are no running statistics.

    Args:
        task: The task.
        robot: The robot, whose limits scale joint positions and velocities.
        n_actions: Size of the residual action.

    Attributes:
        layout: (name, size, scale) of every part, in order.
        size: Length of the vector.
    """

    def __init__(self, task: Task, robot: RobotDescription, n_actions: int) -> None:
        self._robot = robot
        self._q_middle = (robot.q_upper + robot.q_lower) / 2
        self._q_half = (robot.q_upper - robot.q_lower) / 2
        self._one_hot = np.eye(len(task.phases)).tolist()
        self._dt = task.scene.control_dt
        self._time_limit = task.time_limit
        self._others = _others(task)
        self._manipulated = task.manipulated
        self._n_past = task.residual.history
        self._history: deque[SceneState] = deque(maxlen=self._n_past)
        self.layout = observation_layout(task, n_actions)
        self.size = sum(size for _, size, _ in self.layout)
        self._scale = np.concatenate([np.full(size, scale) for _, size, scale in self.layout])
        ends = np.cumsum([size for _, size, _ in self.layout])
        self._place = {part[0]: slice(end - part[1], end) for part, end in zip(self.layout, ends, strict=True)}

    def reset(self, state: SceneState) -> None:
        """Fill the history with the first state."""
        self._history.clear()
        self._history.extend([state] * self._n_past)

    def push(self, state: SceneState) -> None:
        """Append the state of one control step."""
        self._history.append(state)

    def build(self, executor: PhaseExecutor, last_action: Array) -> NDArray[np.float32]:
        """Return the observation at the start of a decision, shape (size,).

        Args:
            executor: The running program, after its latest `advance`.
            last_action: The residual action of the previous decision, shape (n_actions,).
        """
        frame, plan = executor.frame, executor.action
        to_frame = frame.rotation  # row vectors: v_frame = v_world @ R_world_frame
        name = executor.phase.target.object
        *_, before, state = self._history
        body, hand, plan_pose = state.objects[name], state.ee, plan.target.pose
        vectors: list[Array] = []
        for past in reversed(self._history):
            then = past.objects[name]
            vectors += (past.ee.position - then.pose.position, then.velocity)
        vectors += (hand.position - before.ee.position, body.angular_velocity)
        for other in self._others:
            vectors += _body_features(state, other)
        vectors += (
            plan_pose.position - hand.position,
            rotvec_from_matrix(plan_pose.rotation @ hand.rotation.T),
        )
        turned = np.array(vectors) @ to_frame
        end = 2 * self._n_past
        turned[end] /= self._dt  # the first after the history, of the hand's position, becomes its velocity
        rows = turned.tolist()
        history = zip(rows[:end:2], rows[1:end:2], reversed(self._history), strict=True)
        parts: Iterable[Sequence[float]] = (
            *(part for where, speed, past in history for part in (where, speed, self._fingers(past))),
            *rows[end:-2],
            body.pose.position.tolist(),
            to_frame[:2, 0].tolist(),
            *rows[-2:],
            (plan.target.width,),
            ((state.q - self._q_middle) / self._q_half).tolist(),
            (state.dq / self._robot.dq_max).tolist(),
            self._one_hot[plan.phase],
            (plan.gate, executor.frozen, executor.phase_time_left, 1.0 - state.time / self._time_limit),
            last_action.tolist(),
        )
        vector = np.array([*chain.from_iterable(parts)]) / self._scale
        clipped: NDArray[np.float32] = np.clip(vector, -LIMIT, LIMIT).astype(np.float32)
        return clipped

    def read(self, name: str, observation: NDArray[np.float32]) -> Array:
        """Return one part of an observation in SI units, as `layout` names it.

        Args:
            name: Its name.
            observation: What `build` returned, shape (size,).
        """
        place = self._place[name]
        values: Array = observation[place] * self._scale[place]
        return values

    def _fingers(self, state: SceneState) -> tuple[float, ...]:
        return (state.width, *state.touching[self._manipulated])


def _body_features(state: SceneState, name: str) -> tuple[Array, Array, Array]:
    """Return the features `_PER_BODY` of a body, along the axes of the world."""
    body = state.objects[name]
    return body.pose.position - state.ee.position, body.velocity, body.pose.rotation[:, 2]


def observation_layout(task: Task, n_actions: int) -> tuple[tuple[str, int, float], ...]:
    """Return (name, size, scale) of every part of the observation, in order."""
    return (
        *((f"{name}[{-k}]", size, scale) for k in range(task.residual.history) for name, size, scale in _PER_STEP),
        ("ee_velocity", 3, 1.0),
        ("object_angular_velocity", 3, 20.0),
        *((f"{name}/{part}", size, scale) for name in _others(task) for part, size, scale in _PER_BODY),
        ("object_position", 3, 0.5),
        ("heading", 2, 1.0),
        ("plan_from_ee", 3, 0.1),
        ("plan_rotation_from_ee", 3, 1.0),
        ("plan_width", 1, 0.08),
        ("q", 7, 1.0),
        ("dq", 7, 1.0),
        ("phase", len(task.phases), 1.0),
        ("gate", 1, 1.0),
        ("frozen", 1, 1.0),
        ("phase_time_left", 1, 1.0),
        ("time_left", 1, 1.0),
        ("last_residual", n_actions, 1.0),
    )


def residual_sizes(task: Task) -> tuple[int, int]:
    """Return the sizes of a task's observation and residual action, without making the env."""
    n_actions = sum(scale != 0.0 for scale in task.residual.scales)
    return sum(size for _, size, _ in observation_layout(task, n_actions)), n_actions


def _others(task: Task) -> tuple[str, ...]:
    """Return the names of the bodies that have features of their own: all tracked ones, where there are several."""
    return task.scene.tracked if len(task.scene.tracked) > 1 else ()


def is_finite(values: NDArray[Any]) -> bool:
    """Return whether a short vector contains neither NaN nor infinity; faster than numpy on a few numbers."""
    return math.isfinite(float(values.sum()))
