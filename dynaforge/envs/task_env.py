"""The Gymnasium env whose action is absolute: an end-effector target, or joint targets."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynaforge.envs.base import WorldEnv, check_choice
from dynaforge.envs.world import LOWEST_EE
from dynaforge.geometry import Array, Pose, matrix_from_rotvec
from dynaforge.sim import SceneState
from dynaforge.tasks import Task
from dynaforge.tasks.targets import DOWN_ALONG_X
from dynaforge.tasks.view import PhaseView, heading_frames

Observation = NDArray[np.float64]

ACTION_MODES = ("ee", "joint")
WORKSPACE_LOW = (0.0, -0.8, LOWEST_EE)
WORKSPACE_HIGH = (0.8, 0.8, 0.9)


class TaskEnv(WorldEnv):
    """A task without its prior: for imitation policies, replay, and learning from scratch.

    One step is one control step. The reward is 1 when the task's success held long enough and 0 otherwise; an
    episode also ends when success has become impossible or time is up. Every info holds "is_success".

    Args:
        task: Task name or a Task.
        action_mode: "ee": target position (m, base frame), rotation vector from the straight-down hand (rad), gripper
            width (m), shape (7,). "joint": seven joint targets (rad) and gripper width (m), shape (8,).
        render_mode: None, "rgb_array" or "human".

    Raises:
        ValueError: Unknown task, action mode or render mode.
    """

    def __init__(self, task: str | Task = "can", *, action_mode: str = "ee", render_mode: str | None = None) -> None:
        check_choice("action_mode", action_mode, ACTION_MODES)
        super().__init__(task, render_mode)
        self.action_mode = action_mode
        robot = self.world.scene.robot
        if action_mode == "ee":
            low, high = (*WORKSPACE_LOW, *[-np.pi] * 3, 0.0), (*WORKSPACE_HIGH, *[np.pi] * 3, robot.width_max)
        else:
            low, high = (*robot.q_lower, 0.0), (*robot.q_upper, robot.width_max)
        self.action_space = gym.spaces.Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)
        self.layout = (
            ("q", 7),
            ("dq", 7),
            ("ee_position", 3),
            ("ee_quat_wxyz", 4),
            ("width", 1),
            *(
                (f"{body}/{name}", size)
                for body in self.task.scene.tracked
                for name, size in (
                    ("position", 3), ("quat_wxyz", 4), ("velocity", 3), ("angular_velocity", 3), ("touching", 2),
                )
            ),
            ("time_left", 1),
        )  # fmt: skip
        size = sum(size for _, size in self.layout)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; `options={"condition": ...}` fixes it."""
        super().reset(seed=seed)
        self._condition = self._chosen(options)
        self._start = self._state = self.world.reset(self._condition)
        self._frames = heading_frames(self._state, None)
        self._held = 0
        return self._observation(), {"condition_id": self._condition.id}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move toward the commanded target for one control step.

        Raises:
            ValueError: Wrong shape, NaN or infinity.
            RuntimeError: Called before `reset`.
        """
        values = self._checked(action)
        values = np.clip(values, self.action_space.low, self.action_space.high)  # type: ignore[attr-defined]
        if self.action_mode == "ee":
            rotation = matrix_from_rotvec(values[3:6]) @ DOWN_ALONG_X
            self._state = self.world.track(Pose(rotation, values[:3]), float(values[6]))
        else:
            self._state = self.world.track_joints(values[:7], float(values[7]))
        self._frames = heading_frames(self._state, self._frames)
        success, failure = self._judge()
        info: dict[str, Any] = {"is_success": success}
        if success or failure:
            assert self._condition is not None
            info |= {"failure": failure, "condition_id": self._condition.id, "difficulty": self._condition.difficulty}
        return self._observation(), float(success), bool(success or failure), False, info

    def _judge(self) -> tuple[bool, str]:
        """Tell whether the task's success has held long enough, and the reason of a failure."""
        state, last = self._state, self.task.phases[-1]
        view = PhaseView(state, self._start, self._start, self._frames, self._frames)
        for reason, holds in self.task.endings:
            if holds(view, state.ee):
                return False, reason
        self._held = self._held + 1 if last.done(view, state.ee) else 0
        if last.is_held(self._held, self.task.scene.control_dt):
            return True, ""
        return False, "timeout" if state.time >= self.task.time_limit - 1e-9 else ""

    def _observation(self) -> Observation:
        return observe_flat(self._state, self.task)


def observe_flat(state: SceneState, task: Task) -> Array:
    """Lay the privileged state out flat, SI units, in the order of `TaskEnv.layout`."""
    parts: list[Any] = [state.q, state.dq, state.ee.position, state.ee.quat_wxyz, (state.width,)]
    for name in task.scene.tracked:
        body = state.objects[name]
        parts += [body.pose.position, body.pose.quat_wxyz, body.velocity, body.angular_velocity]
        parts.append(tuple(map(float, state.touching[name])))
    parts.append((1.0 - state.time / task.time_limit,))
    return np.concatenate(parts)
