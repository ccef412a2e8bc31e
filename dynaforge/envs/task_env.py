"""The Gymnasium env whose action is absolute: a target for the hand, or targets for the joints."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynaforge.envs.base import RenderMode, WorldEnv
from dynaforge.geometry import Array, Pose
from dynaforge.sim import HandTarget, SceneState
from dynaforge.sim.camera import Visuals
from dynaforge.sim.setting import Physics, Reflex, Sensing
from dynaforge.sim.state import BODY_COLUMNS
from dynaforge.tasks import Outcome, Task
from dynaforge.tasks.action import ActionLayout, ActionMode, RotationForm
from dynaforge.tasks.success import SuccessJudge

Observation = NDArray[np.float64]
_PER_BODY = (*((name, column.size) for name, column in BODY_COLUMNS.items()), ("touching", 2))


class TaskEnv(WorldEnv):
    """A task without its prior: for imitation policies, replay, and learning from scratch.

    One step is one control step. The reward is 1 once the task's success predicate was true for the required time, else
    0; an episode also ends when success has become impossible or time is up. Every info contains "is_success".

    An action is a target for the end of the control step; it is reached exactly wherever the limits allow. The rows of
    an export are such actions (`demos.exporters`).

    Args:
        task: A task, or its name.
        action_mode: "ee": target position (m, base frame), rotation and gripper width (m). "joint": seven joint
            targets (rad) and gripper width (m), shape (8,).
        rotation: Form of the rotation in mode "ee": "rotvec" from the hand that points straight down (rad), "quat_wxyz"
            or "rotation_6d".
        elbow: Whether the width is followed by the third joint's angle (rad) in mode "ee", which determines the arm's
            seventh degree of freedom.
        render_mode: None, "rgb_array" or "human".
        visuals: "plain" loads the shapes that the cameras of an export see (`generators.bridge`).
        reflex, physics, sensing: The setting, as `Setting` explains it; None takes the task's own.

    Raises:
        ValueError: The task, action mode, rotation, render mode or a part of the setting is unknown.
    """

    def __init__(
        self,
        task: str | Task = "can",
        *,
        action_mode: ActionMode = "ee",
        rotation: RotationForm = "rotvec",
        elbow: bool = False,
        render_mode: RenderMode | None = None,
        visuals: Visuals = False,
        reflex: Reflex | None = None,
        physics: Physics | None = None,
        sensing: Sensing | None = None,
    ) -> None:
        self.action_layout = ActionLayout(action_mode, rotation, elbow)
        super().__init__(task, render_mode, visuals=visuals, reflex=reflex, physics=physics, sensing=sensing)
        self.action_mode = action_mode
        robot = self.world.scene.robot
        low, high = self.action_layout.bounds(robot.q_lower, robot.q_upper, robot.width_max)
        self.action_space = gym.spaces.Box(low, high, dtype=np.float32)
        self.layout = (
            ("q", 7),
            ("dq", 7),
            ("ee_position", 3),
            ("ee_quat_wxyz", 4),
            ("width", 1),
            *((f"{body}/{name}", size) for body in self.task.scene.tracked for name, size in _PER_BODY),
            ("time_left", 1),
        )
        size = sum(size for _, size in self.layout)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Seeds the env's own draws of conditions.
            options: `{"condition": Condition}` (or its `to_dict` form) fixes the episode; without it one is drawn.

        Raises:
            ValueError: An option is unknown, or the condition is not one of this task.
        """
        super().reset(seed=seed)
        condition = self._chosen(options)
        self._state = self.world.reset(condition)
        self._condition = condition
        self._success = SuccessJudge(self.task, self._state)
        self.outcome: Outcome | None = None
        return self._observation(), {"condition_id": self._condition.id}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move to the commanded target, or as near to it as the limits allow in one control step.

        Where its numbers describe no rotation, such as a quaternion of zeros, the hand keeps its present one.

        Args:
            action: The target, in the terms of `action_layout`; values outside the action space are clipped.

        Raises:
            ValueError: The shape is wrong, or a value is not finite.
            RuntimeError: Called before `reset`.
        """
        values = self._checked(action)
        values = np.clip(values, self.action_space.low, self.action_space.high)  # type: ignore[attr-defined]
        self._state = self._move(values)
        self.outcome = self._outcome_now()
        info: dict[str, Any] = {"is_success": False}
        if self.outcome is not None:
            assert self._condition is not None
            info |= self.outcome.as_info()
            info |= {"condition_id": self._condition.id, "difficulty": self._condition.difficulty}
        return self._observation(), float(info["is_success"]), self.outcome is not None, False, info

    def _move(self, action: Array) -> SceneState:
        if self.action_mode == "joint":
            return self.world.reach_joints(action[:7], self.action_layout.width(action))
        elbow = float(action[-1]) if self.action_layout.elbow else None
        return self.world.reach(self._hand_target(action), elbow=elbow)

    def _hand_target(self, action: Array) -> HandTarget:
        try:
            return self.action_layout.hand_target(action)
        except ValueError:  # no rotation; a policy that learns from scratch does visit such corners of the action space
            rotation = self.world.kinematics.forward(self.world.reference.joints.q).rotation
            return HandTarget(Pose(rotation, action[:3]), self.action_layout.width(action))

    def _outcome_now(self) -> Outcome | None:
        """Return the outcome if the episode ends with this state; None if it continues."""
        state = self._state
        success = self._success.push(state)
        for reason, impossible in self.task.endings:
            if impossible(self._success.view, state.ee):
                return self._ended(failure=reason)
        if success:
            return self._ended()
        return self._ended(failure="timeout") if state.time >= self.task.time_limit - 1e-9 else None

    def _ended(self, *, failure: str = "") -> Outcome:
        n = self.task.n_checkpoints  # without a phase program the last checkpoint is the only one
        return Outcome(success=not failure, checkpoint=0 if failure else n, n_checkpoints=n, failure=failure)

    def _observation(self) -> Observation:
        return observe_flat(self.world.sensed, self.task)


def observe_flat(state: SceneState, task: Task) -> Array:
    """Lay the privileged state out flat, SI units, in the order of `TaskEnv.layout`."""
    parts: list[Any] = [state.q, state.dq, state.ee.position, state.ee.quat_wxyz, (state.width,)]
    for name in task.scene.tracked:
        parts += state.objects[name].columns.values()
        parts.append(tuple(map(float, state.touching[name])))
    parts.append((1.0 - state.time / task.time_limit,))
    return np.concatenate(parts)
