"""What both envs of a task share: its world, its conditions, its pictures, and checks of arguments."""

from __future__ import annotations

from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynaforge.envs.observation import is_finite
from dynaforge.envs.world import World
from dynaforge.geometry import Array
from dynaforge.sim import Condition
from dynaforge.sim.camera import Visuals, film_camera
from dynaforge.sim.checks import check_choice
from dynaforge.sim.setting import Physics, Reflex, Sensing
from dynaforge.tasks import ConditionSpace, Task, get_task

RenderMode = Literal["rgb_array", "human"]


class WorldEnv(gym.Env[NDArray[Any], NDArray[np.float32]]):
    """An env in a task's world; subclasses define what an action means and when an episode ends.

    Args:
        task: A task, or its name.
        render_mode: None, "rgb_array" or "human".
        visuals: Which visual shapes to load, as in `SimScene`, besides those that the render mode needs.
        reflex, physics, sensing: The setting, as `Setting` explains it; None takes the task's own.

    Raises:
        ValueError: The task, the render mode or a part of the setting is unknown.
        OSError: Mode "human" without a display.
    """

    metadata: dict[str, Any] = {"render_modes": list(get_args(RenderMode)), "render_fps": 30}

    def __init__(
        self,
        task: str | Task,
        render_mode: RenderMode | None,
        *,
        visuals: Visuals = False,
        reflex: Reflex | None = None,
        physics: Physics | None = None,
        sensing: Sensing | None = None,
    ) -> None:
        task = task if isinstance(task, Task) else get_task(task)
        self.task = task.under(reflex=reflex, physics=physics, sensing=sensing)
        check_choice("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.task.scene.control_dt)}
        self.world = World(self.task, visuals=visuals or render_mode == "rgb_array", gui=render_mode == "human")
        self._closed = False
        self._film_camera = film_camera(self.task.camera)
        self._condition: Condition | None = None

    @property
    def condition_sampler(self) -> ConditionSpace:
        """The space of the task's conditions, which draws them and knows how to reset an env to them."""
        return self.task.conditions

    def render(self) -> NDArray[np.uint8] | None:
        """Return an (H, W, 3) uint8 image in mode "rgb_array", else None; the window of mode "human" draws itself.

        Raises:
            RuntimeError: The env is closed.
        """
        self._must_be_open()
        if self.render_mode != "rgb_array":
            return None
        return self.world.scene.picture(self._film_camera)

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._closed = True
        self.world.close()

    def _must_be_open(self) -> None:
        if self._closed:
            raise RuntimeError("This env is closed; make a new one.")

    def _chosen(self, options: dict[str, Any] | None) -> Condition:
        """Read the condition from reset options, or draw one; `World.reset` checks that it is one of this task.

        Raises:
            ValueError: An option is unknown, or is not a condition.
            RuntimeError: The env is closed.
        """
        self._must_be_open()
        options = options or {}
        if unknown := sorted(set(options) - {"condition"}):
            raise ValueError(f"Unknown reset options {unknown}; the one known is 'condition'.")
        condition = options.get("condition")
        if condition is None:
            return self.task.conditions.draw(self.np_random)
        if isinstance(condition, dict):
            condition = Condition.from_dict(condition)
        if not isinstance(condition, Condition):
            raise ValueError(f"options['condition'] must be a Condition or its dict, got {type(condition).__name__}.")
        return condition

    def _checked(self, action: Any) -> Array:
        """Return an action as float64.

        Raises:
            ValueError: The shape is wrong, or a value is not finite.
            RuntimeError: No episode was started, or the env is closed.
        """
        self._must_be_open()
        if self._condition is None:
            raise RuntimeError("step() before reset(): call env.reset() first.")
        values = np.asarray(action, dtype=np.float64)
        if values.shape != self.action_space.shape or not is_finite(values):
            raise ValueError(f"Action must be {self.action_space.shape} finite numbers, got {action}.")
        return values
