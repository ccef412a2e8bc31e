"""Three ways of running single episodes on the rows of a VecEnv, behind one interface."""

from __future__ import annotations

from typing import Any, Protocol, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from dynaforge.sampling.sampler import Group, Job
from dynaforge.sampling.vec_wrappers import Observations, put_rows, take_rows

Step = tuple[Observations, NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]


class JobRoute(Protocol):
    """Runs the episode that a row is assigned, and leaves the row idle once it is over.

    A row that was assigned a job starts it at the next `step`: its action is ignored, its observation is the first
    one, reward 0, done False, info the reset info with "episode_start". Idle rows earn 0 and are never done.
    """

    def assign(self, row: int, job: Job) -> None:
        """Start a job on a row at the next step."""

    def drop(self, row: int) -> None:
        """Abandon the episode of a row, where the VecEnv can."""

    def step(self, actions: Any) -> Step:
        """Advance all rows by one step."""

    def release(self) -> None:
        """Restore the VecEnv's automatic resets."""


def choose_route(base: VecEnv) -> JobRoute:
    """Return the best route for an innermost VecEnv: its own job mode, else one process, else that of any VecEnv."""
    if callable(getattr(base, "assign", None)) and callable(getattr(base, "park_when_done", None)):
        return NativeRoute(base)
    if type(base).step_wait is DummyVecEnv.step_wait:
        return InProcessRoute(base)
    return StockRoute(base)


def idle_action(space: spaces.Space[Any]) -> Any:
    """Return a valid action for rows whose action is ignored: zeros, clipped to the space."""
    if isinstance(space, spaces.Box):
        return np.clip(np.zeros(space.shape, space.dtype), space.low, space.high)
    if isinstance(space, spaces.Discrete):
        return np.asarray(space.start, space.dtype)
    return np.zeros(space.shape or (), space.dtype)


class NativeRoute:
    """Uses the job mode of a VecEnv with `park_when_done` and `assign`: idle envs do not simulate at all."""

    def __init__(self, base: Any) -> None:
        self._base = base
        self._parking = False

    def assign(self, row: int, job: Job) -> None:
        if not self._parking:
            self._parking = True  # before the call: a Ctrl-C inside it may come after the VecEnv has switched
            self._base.park_when_done(True)
        self._base.assign(row, dict(job.group.reset_kwargs))

    def drop(self, row: int) -> None:
        """Do nothing: the env runs on, unread, until its episode ends or it is assigned another."""

    def step(self, actions: Any) -> Step:
        return cast(Step, self._base.step(actions))

    def release(self) -> None:
        if self._parking:
            self._base.park_when_done(False)
            self._parking = False


class _EmulatedRoute:
    """Keeps track of idle, starting and running rows for a VecEnv without a job mode."""

    def __init__(self, base: VecEnv) -> None:
        self._base = base
        self._running = np.zeros(base.num_envs, dtype=bool)
        self._assigned: dict[int, Job] = {}
        self._idle_action = idle_action(base.action_space)
        self._obs = _blank(base.observation_space, base.num_envs)

    def assign(self, row: int, job: Job) -> None:
        self._assigned[row] = job

    def drop(self, row: int) -> None:
        self._running[row] = False

    def release(self) -> None:
        self._running[:] = False
        self._assigned.clear()

    def _blank_step(self) -> tuple[NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        n = self._base.num_envs
        return np.zeros(n), np.zeros(n, dtype=bool), [{"idle": True} for _ in range(n)]

    def _start_assigned(self, infos: list[dict[str, Any]]) -> None:
        rows_of: dict[Group, list[int]] = {}  # the rows of a group reset in one call, in parallel where envs are
        for row, job in self._assigned.items():
            rows_of.setdefault(job.group, []).append(row)
        for group, rows in rows_of.items():
            started = self._base.env_method("reset", indices=rows, **group.reset_kwargs)
            for row, (first, info) in zip(rows, started, strict=True):
                put_rows(self._obs, row, first)
                infos[row] = {**info, "episode_start": True}
                self._running[row] = True
        self._assigned.clear()


class InProcessRoute(_EmulatedRoute):
    """Steps the envs of a `DummyVecEnv` one by one, so that idle ones are not stepped and none resets twice."""

    def step(self, actions: Any) -> Step:
        rewards, dones, infos = self._blank_step()
        for row in np.flatnonzero(self._running).tolist():
            if row in self._assigned:
                continue
            taken = self._base.env_method("step", actions[row], indices=[row])[0]
            last, rewards[row], terminated, truncated, info = taken
            put_rows(self._obs, row, last)
            dones[row] = terminated or truncated
            infos[row] = {**info, "TimeLimit.truncated": truncated and not terminated}
            if dones[row]:
                infos[row]["terminal_observation"] = last
                self._running[row] = False
        self._start_assigned(infos)
        return _copy(self._obs), rewards, dones, infos


class StockRoute(_EmulatedRoute):
    """Steps any VecEnv, for instance `SubprocVecEnv`: idle envs take idle actions in episodes that nobody reads.

    Those steps and the automatic resets cost time, and a Monitor file of an env counts such episodes too.
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
        for row in np.flatnonzero(acting).tolist():
            rewards[row], dones[row], infos[row] = stepped[1][row], stepped[2][row], dict(stepped[3][row])
            last = infos[row]["terminal_observation"] if dones[row] else take_rows(obs, row)
            put_rows(self._obs, row, last)
            self._running[row] = not dones[row]
        self._start_assigned(infos)
        return _copy(self._obs), rewards, dones, infos


def _blank(space: spaces.Space[Any], n: int) -> Observations:
    if isinstance(space, spaces.Dict):
        return {key: np.zeros((n, *(part.shape or ())), part.dtype) for key, part in space.spaces.items()}
    return np.zeros((n, *(space.shape or ())), space.dtype)


def _copy(obs: Observations) -> Observations:
    return {key: part.copy() for key, part in obs.items()} if isinstance(obs, dict) else obs.copy()
