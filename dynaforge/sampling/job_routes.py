"""Three ways of running single episodes on the rows of a VecEnv, behind one face."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from dynaforge.sampling.vec_wrappers import Observations, put_rows, take_rows

Step = tuple[Observations, NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]


class JobRoute(Protocol):
    """Rows that start an episode when told so, and stay idle when it is over.

    A row that was assigned an episode starts it at the next `step`: its action is ignored, its observation is the
    first one, reward 0, done False, info the reset info with "episode_start". Idle rows earn 0 and never finish.
    """

    def assign(self, index: int, reset_kwargs: Mapping[str, Any]) -> None:
        """Let row `index` start an episode at the next step."""

    def drop(self, index: int) -> None:
        """Let row `index` leave its episode, where the VecEnv can."""

    def step(self, actions: Any) -> Step:
        """Advance all rows by one step."""

    def release(self) -> None:
        """Give the VecEnv back its ordinary behaviour."""


def choose_route(base: VecEnv) -> JobRoute:
    """Pick the best route an innermost VecEnv offers: its own job mode, one process, or any VecEnv."""
    if callable(getattr(base, "assign", None)) and callable(getattr(base, "park_when_done", None)):
        return NativeRoute(base)
    if type(base).step_wait is DummyVecEnv.step_wait:
        return InProcessRoute(base)
    return StockRoute(base)


def idle_action(space: spaces.Space[Any]) -> Any:
    """Return a harmless valid action: zeros, moved into the space where it does not hold zero."""
    if isinstance(space, spaces.Box):
        return np.clip(np.zeros(space.shape, space.dtype), space.low, space.high)
    if isinstance(space, spaces.Discrete):
        return np.asarray(space.start, space.dtype)
    return np.zeros(space.shape or (), space.dtype)


class NativeRoute:
    """The job mode of a VecEnv that has `park_when_done` and `assign`: idle envs do not simulate at all."""

    def __init__(self, base: Any) -> None:
        self._base = base
        self._parking = False

    def assign(self, index: int, reset_kwargs: Mapping[str, Any]) -> None:
        if not self._parking:
            self._parking = True  # first: a Ctrl-C inside the call must not hide that it may have been heard
            self._base.park_when_done(True)
        self._base.assign(index, dict(reset_kwargs))

    def drop(self, index: int) -> None:
        """Nothing: the env runs on, unseen, until its episode ends or it is assigned another."""

    def step(self, actions: Any) -> Step:
        return cast(Step, self._base.step(actions))

    def release(self) -> None:
        if self._parking:
            self._base.park_when_done(False)
            self._parking = False


class _EmulatedRoute:
    """Keeps the book of idle, starting and running rows that a stock VecEnv does not keep."""

    def __init__(self, base: VecEnv) -> None:
        self._base = base
        self._running = np.zeros(base.num_envs, dtype=bool)
        self._assigned: dict[int, Mapping[str, Any]] = {}
        self._idle_action = idle_action(base.action_space)
        self._obs = _blank(base.observation_space, base.num_envs)

    def assign(self, index: int, reset_kwargs: Mapping[str, Any]) -> None:
        self._assigned[index] = reset_kwargs

    def drop(self, index: int) -> None:
        self._running[index] = False

    def release(self) -> None:
        self._running[:] = False
        self._assigned.clear()

    def _blank_step(self) -> tuple[NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        n = self._base.num_envs
        return np.zeros(n), np.zeros(n, dtype=bool), [{"idle": True} for _ in range(n)]

    def _start_assigned(self, infos: list[dict[str, Any]]) -> None:
        together: dict[int, list[int]] = {}  # rows that share one reset_kwargs object reset at the same time
        for index, reset_kwargs in self._assigned.items():
            together.setdefault(id(reset_kwargs), []).append(index)
        for rows in together.values():
            started = self._base.env_method("reset", indices=rows, **self._assigned[rows[0]])
            for index, (first, info) in zip(rows, started, strict=True):
                put_rows(self._obs, index, first)
                infos[index] = {**info, "episode_start": True}
                self._running[index] = True
        self._assigned.clear()


class InProcessRoute(_EmulatedRoute):
    """`DummyVecEnv`: its envs are reached one by one, so idle ones are not stepped and nothing resets twice."""

    def step(self, actions: Any) -> Step:
        rewards, dones, infos = self._blank_step()
        for index in np.flatnonzero(self._running).tolist():
            if index in self._assigned:
                continue
            taken = self._base.env_method("step", actions[index], indices=[index])[0]
            last, rewards[index], terminated, truncated, info = taken
            put_rows(self._obs, index, last)
            dones[index] = terminated or truncated
            infos[index] = {**info, "TimeLimit.truncated": truncated and not terminated}
            if dones[index]:
                infos[index]["terminal_observation"] = last
                self._running[index] = False
        self._start_assigned(infos)
        return _copy(self._obs), rewards, dones, infos


class StockRoute(_EmulatedRoute):
    """Any VecEnv, for instance `SubprocVecEnv`: idle envs take idle actions in episodes that nobody looks at.

    Costs what those steps and the automatic resets cost. A Monitor file of an env counts such episodes too.
    """

    def __init__(self, base: VecEnv) -> None:
        super().__init__(base)
        base.reset()  # Idle rows are stepped as well, and may never have been reset.

    def step(self, actions: Any) -> Step:
        rewards, dones, infos = self._blank_step()
        acting = self._running.copy()
        acting[list(self._assigned)] = False
        actions = np.array(actions)
        actions[~acting] = self._idle_action
        stepped = self._base.step(actions)
        obs = cast(Observations, stepped[0])
        for index in np.flatnonzero(acting).tolist():
            rewards[index], dones[index], infos[index] = stepped[1][index], stepped[2][index], dict(stepped[3][index])
            last = infos[index]["terminal_observation"] if dones[index] else take_rows(obs, index)
            put_rows(self._obs, index, last)
            self._running[index] = not dones[index]
        self._start_assigned(infos)
        return _copy(self._obs), rewards, dones, infos


def _blank(space: spaces.Space[Any], n: int) -> Observations:
    if isinstance(space, spaces.Dict):
        return {key: np.zeros((n, *(part.shape or ())), part.dtype) for key, part in space.spaces.items()}
    return np.zeros((n, *(space.shape or ())), space.dtype)


def _copy(obs: Observations) -> Observations:
    return {key: part.copy() for key, part in obs.items()} if isinstance(obs, dict) else obs.copy()
