"""The Gymnasium env whose action is a residual on the planner's action, Eq. 5."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynaforge.envs.base import RenderMode, WorldEnv
from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.observation import LIMIT, ObservationBuilder, residual_sizes
from dynaforge.envs.prefix import Answer, Prefix
from dynaforge.envs.residual import ResidualScale
from dynaforge.geometry import Array
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_choice, check_flag, check_number
from dynaforge.sim.setting import Physics, Reflex, Sensing
from dynaforge.sim.snapshot import put_back, remember
from dynaforge.tasks import FRAMES, Frame, Task, get_task
from dynaforge.tasks.digest import definition_of

Observation = NDArray[np.float32]

GateMode = Literal["skip", "mask"]
GATE_MODES: tuple[GateMode, ...] = get_args(GateMode)


class ResidualEnv(WorldEnv):
    """A task with its planning prior inside: the action only corrects it.

    One step is one decision: an action kept for up to `decision_steps` control steps, fewer where the gate changes. Its
    residual turns with its frame at every control step.
    The reward is 0 until the end and then R of Eq. 6. A timeout terminates, since truncation would make
    Stable-Baselines3 add a bootstrapped value to R. Every info contains "is_success", which is False until success.

    Films run at true speed. RecordVideo, VecVideoRecorder and "rgb_array_list" take one image per step; so while
    pictures are taken, a step is one control step, 1 / metadata["render_fps"] seconds. After a `render()` that follows
    a step, the next step ends after one control step; where no decision is due, its action is ignored and the one
    before is kept. After a `render()` that follows a reset, the episode begins again at t = 0, before the phases that
    the reset had run through. Decisions and observations are those of the same episode without a film: a policy that
    depends only on its observations ends in the same state, bit for bit. An env that is never rendered steps as one
    without `render_mode`.

    Args:
        task: A task, or its name.
        gate_mode: "skip": `step` passes over phases whose gate is closed, so that every action has an effect and
            decisions differ in duration. "mask": every decision is a step, and `info["residual_mask"]` is 1 for those
            that count. Both give the same gated decisions.
        render_mode: None, "rgb_array" or "human".
        lead_time: Seconds of constant-velocity prediction in the prior; None takes the task's own, which is 0 in the
            paper. As the frame, it is part of the env's `task`, and so of its digest.
        residual_frame: "target" or "world"; None takes the task's own.
        reflex, physics, sensing: The setting, as `Setting` explains it; None takes the task's own.
        share_prefix: Whether an episode of the same condition as the one before goes back to the world at its first
            gate instead of simulating again what comes before it. Both give the same bits. An env that films, senses as
            a real one does or is listened to never does so. In gate mode "mask", the steps before the gate are then
            answered from memory, while `world` is at the gate already.

    Raises:
        ValueError: The task, gate mode, render mode, frame or a part of the setting is unknown.
        OSError: Mode "human" without a display.
    """

    def __init__(
        self,
        task: str | Task = "can",
        *,
        gate_mode: GateMode = "skip",
        render_mode: RenderMode | None = None,
        lead_time: float | None = None,
        residual_frame: Frame | None = None,
        reflex: Reflex | None = None,
        physics: Physics | None = None,
        sensing: Sensing | None = None,
        share_prefix: bool = True,
    ) -> None:
        check_flag("share_prefix", share_prefix)
        check_choice("gate_mode", gate_mode, GATE_MODES)
        check_choice("residual_frame", residual_frame, (None, *FRAMES))
        task = task if isinstance(task, Task) else get_task(task)
        if residual_frame is not None:
            task = replace(task, residual=replace(task.residual, frame=residual_frame))
        if lead_time is not None:
            check_number("lead_time", lead_time, least=0.0)
            task = replace(task, lead_time=lead_time)
        super().__init__(task, render_mode, reflex=reflex, physics=physics, sensing=sensing)
        self.gate_mode = gate_mode
        self.executor = PhaseExecutor(self.task, self.world.planner, control_dt=self.task.scene.control_dt)
        self.residual_scale = ResidualScale(self.task.residual)
        self.residual_frame = self.residual_scale.frame
        self.observer = ObservationBuilder(self.task, self.world.scene.robot, self.residual_scale.size)
        self.observation_space = gym.spaces.Box(-LIMIT, LIMIT, (self.observer.size,), np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self.residual_scale.size,), np.float32)
        # A sensor draws as it goes on; a picture may be wanted of what comes before the gate.
        self.share_prefix = share_prefix and self.task.setting.sensing == "ideal" and render_mode is None
        self.world.keeps_gate = self.share_prefix
        self._prefix: Prefix | None = None
        self._answers: list[Answer] | None = None  # of this episode, while no gate has opened
        self._untold: deque[Answer] = deque()  # those of the prefix that are still to be given
        self._steps_left = 0  # control steps for which the latest residual is still to be kept
        self._filmed = False  # whether a picture was taken since the latest step or reset
        self._fresh = False  # whether nothing happened since the reset

    @staticmethod
    def sizes(task: str | Task, **_: Any) -> tuple[int, int]:
        """Return the sizes of an observation and an action of a task, without making its env."""
        return residual_sizes(get_task(task) if isinstance(task, str) else task)

    @staticmethod
    def definition(task: str | Task, **_: Any) -> dict[str, Any]:
        """Return what a policy file keeps of the task that it is for: the digest of its definition, and its setting."""
        return definition_of(get_task(task) if isinstance(task, str) else task)

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
        restored = self._restored(condition)
        if not restored:
            self._begin(condition)
            if self.gate_mode == "skip":
                self._run_until_gate()
        self._condition = condition
        self._filmed, self._fresh = False, True
        if restored:
            answer = self._untold.popleft().copy()
        else:
            self._answers = [] if self.share_prefix else None
            answer = self._noted(Answer(self._observation(), 0.0, False, False, {}))
        return answer.observation, {"condition_id": condition.id}

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply one residual decision.

        Args:
            action: Residual in units of its scale, shape (d,); values beyond [-1, 1] are clipped.

        Raises:
            ValueError: The shape is wrong, or a value is not finite.
            RuntimeError: Called before `reset` or after `close`.
        """
        values = self._checked(action)
        if self._untold and self.world.listeners:
            self._simulate_told()
        if self._untold:
            return self._untold.popleft().copy()
        filmed, self._fresh = self._filmed, False
        decides = self._steps_left == 0 and self.executor.outcome is None and self.executor.action.gate
        if decides:
            self._last_action = self.residual_scale.read(values)
            self._steps_left = self.task.residual.decision_steps
        self._run_decision(at_most=1 if filmed else self.task.residual.decision_steps)
        if self.gate_mode == "skip" and not filmed:
            self._run_until_gate()
        self._filmed = False
        return self._noted(self._result(decides))

    def render(self) -> NDArray[np.uint8] | None:
        """Return an (H, W, 3) uint8 image in mode "rgb_array", and make the next step one control step.

        Called between a reset and the first step, it shows t = 0.

        Raises:
            RuntimeError: The env is closed.
        """
        self._must_be_open()
        if self.render_mode == "rgb_array" and self._condition is not None:
            # A listener has already been given the steps that the reset ran, and must not be given them twice.
            if self._fresh and not self.world.listeners:
                self._begin(self._condition)
            self._filmed, self._fresh = True, False
        return super().render()

    def _restored(self, condition: Condition) -> bool:
        """Go back to the first gate of the condition, if that was the latest episode's and nobody listens."""
        prefix = self._prefix
        if prefix is None or prefix.condition != condition or self.world.listeners:
            return False
        if self.world.first_gate is not prefix.first_gate:  # the world was reset by other hands
            return False
        self.world.restore()
        put_back(prefix.memory)
        self._last_action = np.zeros(self.residual_scale.size)
        self._steps_left = 0
        self._answers = None
        self._untold = deque(prefix.answers)
        return True

    def _noted(self, answer: Answer) -> Answer:
        """Note an answer, until one is given at the first gate."""
        if self._answers is None:
            return answer
        self._answers.append(answer.copy())
        if self.executor.outcome is None and self.executor.action.gate:
            assert self._condition is not None
            self._prefix = Prefix(
                condition=self._condition,
                first_gate=self.world.state,
                memory=[*self.executor.memory(), *remember(self.observer)],
                answers=self._answers,
            )
            self._answers = None
        return answer

    def _simulate_told(self) -> None:
        """Simulate what was answered from memory so far, for whoever listens from now on."""
        assert self._prefix is not None
        assert self._condition is not None
        steps = len(self._prefix.answers) - len(self._untold) - 1  # the first of them is the reset's
        listeners, self.world.listeners = self.world.listeners, []
        self._begin(self._condition)
        for _ in range(steps):
            self._run_decision(at_most=self.task.residual.decision_steps)
        self.world.listeners = listeners

    def _begin(self, condition: Condition) -> None:
        state = self.world.reset(condition)
        self._untold.clear()
        self.observer.reset(self.world.sensed)
        self._last_action = np.zeros(self.residual_scale.size)
        self._steps_left = 0
        self.executor.reset(state, condition, self.world.reference, sensed=self.world.sensed)
        self._fresh = False

    def _run_decision(self, *, at_most: int) -> None:
        gated = self._steps_left > 0
        for _ in range(min(self._steps_left, at_most) if gated else at_most):
            if self.executor.outcome is not None:
                return
            residual = self.residual_scale.physical(self._last_action, self.executor) if gated else None
            self._control_step(residual)
            self._steps_left -= gated
            if self.executor.outcome is not None or self.executor.action.gate != gated:
                self._steps_left = 0
                return

    def _run_until_gate(self) -> None:
        while self.executor.outcome is None and not self.executor.action.gate:
            self._control_step(None)

    def _control_step(self, residual: Array | None) -> None:
        state = self.world.execute(self.executor.action, residual)
        self.observer.push(self.world.sensed)
        self.executor.advance(state, self.world.reference, sensed=self.world.sensed)

    def _observation(self) -> Observation:
        return self.observer.build(self.executor, self._last_action)

    def _result(self, gated: bool) -> Answer:
        outcome = self.executor.outcome
        info: dict[str, Any] = {"residual_mask": float(gated), "is_success": False}
        reward = 0.0
        if outcome is not None:
            assert self._condition is not None
            reward = outcome.episodic_return()
            info |= outcome.as_info()
            info |= {"condition_id": self._condition.id, "difficulty": self._condition.difficulty}
        return Answer(self._observation(), reward, outcome is not None, False, info)
