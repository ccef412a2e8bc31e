"""From an export to the env of its actions: a policy learned from the one acts in the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaforge.demos.exporters.frames import STATE, contact_columns, object_columns, robot_columns
from dynaforge.demos.observations import CameraViews, ObservationSettings
from dynaforge.envs.task_env import TaskEnv
from dynaforge.generators.recording import measured
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_kind
from dynaforge.tasks import Task
from dynaforge.tasks.action import ActionLayout

EXPORTED = ActionLayout(elbow=True)
"""The layout of an action in an export with default options."""


class ExportBridge:
    """A task's env in the terms of its exports: exported observations, exported actions.

    Args:
        task: The task, or its name.
        layout: Which numbers an action of the export consists of.
        settings: Settings of the pictures and points in the export; None for an export without them.

    Raises:
        ValueError: The task is unknown, or `layout` or `settings` is of another type.
    """

    def __init__(
        self, task: str | Task, layout: ActionLayout = EXPORTED, *, settings: ObservationSettings | None = None
    ) -> None:
        check_kind("layout", layout, ActionLayout)
        check_kind("settings", settings, (ObservationSettings, type(None)))
        self.env = TaskEnv(task, **layout.env_arguments, visuals=False if settings is None else "plain")
        self.layout = layout
        self._views = None if settings is None else CameraViews(settings)
        self._last_quats: dict[str, NDArray[Any]] | None = None  # None before the first episode

    def reset(self, condition: Condition) -> dict[str, NDArray[Any]]:
        """Start the episode of a condition and return its first observation."""
        self.env.reset(options={"condition": condition})
        self._last_quats = {}
        return self.observation()

    def step(self, action: ArrayLike) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Take one control step with one row of actions, and return what `gymnasium.Env.step` does.

        Args:
            action: Shape (d,), with components as in `layout.names`; values outside the action space are clipped.

        Raises:
            ValueError: The number of components is wrong, one is not finite, or they describe no rotation.
        """
        row = np.asarray(action, dtype=np.float64)
        if row.shape != (len(self.layout.names),):
            raise ValueError(
                f"An action here is {len(self.layout.names)} numbers ({', '.join(self.layout.names)}); given shape "
                f"{row.shape}. A policy trained on another export tells its `layout`."
            )
        if np.isfinite(row).all():
            row = np.clip(row, self.env.action_space.low, self.env.action_space.high)  # type: ignore[attr-defined]
            if self.layout.mode == "ee":
                self.layout.hand_target(row)  # raises: a policy that learned rotations must not give anything else
        _, reward, done, truncated, info = self.env.step(row.astype(np.float32))
        return self.observation(), reward, done, truncated, info

    def observation(self) -> dict[str, NDArray[Any]]:
        """Return the present state as an export contains it, with the names of robomimic's `obs`.

        The robot's `ee_position` (3), `ee_quat_wxyz` (4), `width` (1), `q` (7), `dq` (7); `contact` (2); `state`, the
        first four of these side by side (15), as LeRobot's `observation.state`; for every object
        `<name>_position` and so on, and `object_state`, all of these side by side; with settings `<camera>_image`
        (H, W, 3) uint8, `<camera>_depth` (H, W) uint16 in tenths of a millimetre, `points` and `point_colors`.

        Raises:
            RuntimeError: Called before `reset`.
        """
        if self._last_quats is None:
            raise RuntimeError("observation() before reset(): call reset(condition) first.")
        state = self.env.world.sensed
        steps = measured([state], self.env.task)
        robot, objects = robot_columns(steps), object_columns(steps)
        observation = {name: self._with_steady_sign(name, column[0]) for name, column in (robot | objects).items()}
        observation["contact"] = contact_columns(steps)[0]
        observation["state"] = np.concatenate([observation[name] for name in STATE])
        observation["object_state"] = np.concatenate([observation[name] for name in objects])
        if self._views is not None:
            observation |= _pictures(dict(self._views.of(self.env.world.scene)))
        return observation

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self.env.close()

    def _with_steady_sign(self, name: str, value: NDArray[Any]) -> NDArray[Any]:
        """Return a value, a quaternion with the sign of its value at the control step before, as in exports."""
        if name.endswith("_quat_wxyz"):
            assert self._last_quats is not None
            before = self._last_quats.get(name, value)
            self._last_quats[name] = value = -value if float(value @ before) < 0.0 else value
        return value


def _pictures(views: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    found = {name: views[name] for name in ("point_colors",) if name in views}
    if "points" in views:
        found["points"] = views["points"].astype(np.float32)
    for name, value in views.items():
        camera, _, kind = name.rpartition("/")
        if kind in ("rgb", "depth"):
            found[f"{camera}_{'image' if kind == 'rgb' else kind}"] = value
    return found


def succeeds_again(bridge: ExportBridge, condition: Condition, actions: NDArray[Any]) -> bool:
    """Return whether the actions of a recording succeed in the env under the same condition; the last one is repeated.

    Args:
        bridge: The env, with the layout of the actions.
        condition: The condition of the recording.
        actions: The actions, shape (T, d).
    """
    bridge.env.reset(options={"condition": condition})
    step = 0
    while bridge.env.outcome is None:
        bridge.env.step(actions[min(step, len(actions) - 1)])
        step += 1
    return bridge.env.outcome.success
