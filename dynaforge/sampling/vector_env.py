"""SharedMemoryVecEnv: many envs in a few worker processes, with their data in shared memory.

It stands where SB3's DummyVecEnv or SubprocVecEnv would. One pipe message per worker and step, however many envs the
worker has, keeps the cost of an env-step small; job mode lets a sampler run a list of episodes over any number of
envs without simulating anything in between.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn
from stable_baselines3.common.vec_env.util import dict_to_obs, obs_space_info

from dynaforge.sampling.processes import processor_time, usable_cores
from dynaforge.sampling.sampler import describe_reset
from dynaforge.sampling.vector_errors import WorkerDied, WorkerError, WorkerFailed
from dynaforge.sampling.vector_pool import EnvFn, WorkerPool
from dynaforge.sampling.vector_worker import (
    IDLE,
    STARTED,
    STEP,
    TRUNCATED,
    Layout,
    call_method,
    dump,
    get_attribute,
    has_attribute,
    is_wrapped,
    set_attribute,
)

__all__ = ["SharedMemoryVecEnv", "WorkerDied", "WorkerError", "WorkerFailed"]


class SharedMemoryVecEnv(VecEnv):
    """Step several envs in each of a few worker processes.

    By default an ordinary SB3 vectorised env: a finished episode is followed by an automatic reset, its last
    observation is in info["terminal_observation"]. In job mode (`park_when_done(True)`) a finished env idles until
    `assign` gives it the next episode.

    A worker that dies or hangs, and an env that raises, end the call with an error that names worker, env and
    condition; `close()` always returns within 2 s and leaves no process behind, nor does a kill. Scripts
    need an `if __name__ == "__main__":` guard, as for every env in subprocesses; notebooks and code on stdin do not.

    Args:
        env_fns: One function per env, each making a new env; closures are welcome.
        n_workers: Worker processes; by default as many as the cores that this process may use. More than there are
            envs are not started.
        timeout: Longest time in s that one call into one env may take. Starting may take a minute besides.

    Raises:
        ValueError: No env, no worker, a timeout that is not positive, unequal or unsupported spaces.
        TypeError: An entry of `env_fns` is not a function or cannot be sent to a process.
        WorkerFailed: An env function raised an exception.
        WorkerDied: A worker ended while starting.
    """

    def __init__(self, env_fns: Sequence[EnvFn], *, n_workers: int | None = None, timeout: float = 60.0) -> None:
        n_envs = len(env_fns)
        if n_envs < 1:
            raise ValueError("n_envs is 0: env_fns is empty, expected at least one function that makes an env.")
        if n_workers is None:
            n_workers = usable_cores()
        if n_workers < 1:
            raise ValueError(f"n_workers is {n_workers}, expected at least 1.")
        if not timeout > 0:
            raise ValueError(f"timeout is {timeout}, expected seconds above 0.")
        self._assigned: dict[int, dict[str, Any]] = {}
        self._parking = False
        self._pool = WorkerPool(env_fns, n_workers=min(n_workers, n_envs), timeout=timeout)
        try:
            self._share_memory()
            super().__init__(n_envs, *self._pool.spaces[0])
            self.metadata = dict(self.get_attr("metadata", indices=[0])[0])  # recorders read render_fps from it
        except BaseException:
            self._pool.close()
            raise

    def park_when_done(self, flag: bool) -> None:
        """Switch job mode on or off.

        On, an env whose episode ends idles instead of being reset, and so does an env that was never reset. An idle
        env does not simulate: its observation stays, reward 0, done False, info {"idle": True}. Off, assignments that
        have not begun are forgotten, an episode's end is followed by an automatic reset, and an env that idles is reset
        at the next step as if it had been assigned an episode of its own drawing: no row stays idle.

        Rewards are float64 in job mode, where they are summed up, and float32 otherwise, as those of DummyVecEnv.
        """
        self._parking = bool(flag)
        if not flag:
            self._assigned = {}
        self._pool.exchange({w: dump(("park", bool(flag))) for w in range(len(self._pool.shares))})

    def assign(self, index: int, reset_kwargs: dict[str, Any]) -> None:
        """Give env `index` a new episode: at the next step it ignores its action and is reset with these arguments.

        That step returns the first observation, reward 0, done False and the reset info with
        {"episode_start": True}. Whatever the env was doing is dropped.

        Raises:
            IndexError: There is no such env.
        """
        if not 0 <= index < self.num_envs:
            raise IndexError(f"There is no env {index}, expected 0 to {self.num_envs - 1}.")
        self._assigned[index] = dict(reset_kwargs)

    def reset(self) -> VecEnvObs:
        """Reset every env with the pending seed and options, and return the first observations."""
        kwargs = [
            {"seed": seed, "options": options} if options else {"seed": seed}
            for seed, options in zip(self._seeds, self._options, strict=True)
        ]
        self._assigned = {}
        for index, reset_kwargs in enumerate(kwargs):
            self._pool.labels[index] = describe_reset(reset_kwargs)
        shares = self._pool.shares
        answers = self._pool.exchange(
            {w: dump(("reset", kwargs[share.start : share.stop])) for w, share in enumerate(shares)}
        )
        for worker, share in enumerate(shares):
            for index, info in zip(share, answers[worker], strict=True):
                self._note_reset(index, info)
        self._reset_seeds()
        self._reset_options()
        return self._observations()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Start one step. `actions`: one row per env, shape (n_envs, *action shape)."""
        if np.shape(actions) != self._actions.shape:
            raise ValueError(f"actions have shape {np.shape(actions)}, expected {self._actions.shape}.")
        self._actions[...] = actions
        messages: dict[int, bytes] = dict.fromkeys(range(len(self._pool.shares)), STEP)
        if self._assigned:
            messages |= self._take_assignments()
        self._pool.post(messages)

    def step_wait(self) -> VecEnvStepReturn:
        """Wait for the step: observations, rewards, dones (bool) and infos of all envs, as fresh copies."""
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        status = None
        for payload in self._pool.collect().values():
            if payload is None:
                continue
            step_infos, resets = payload
            for index, info in step_infos.items():
                infos[index] = info
            status = self._status.tolist() if status is None else status
            for index, info in resets.items():
                if status[index] == STARTED:
                    infos[index] = {**info, "episode_start": True}
                else:
                    self._pool.labels[index] = "an episode of its own drawing"
                self._note_reset(index, info)
        for info, code in zip(infos, self._status.tolist(), strict=True):
            if code == IDLE:
                info["idle"] = True
            elif code != STARTED:
                info["TimeLimit.truncated"] = code == TRUNCATED
        rewards = self._rewards.astype(np.float64 if self._parking else np.float32)
        return self._observations(), rewards, self._dones.copy(), infos

    def close(self) -> None:
        """End the workers; returns within 2 s whatever state they are in, and may be called again."""
        self._pool.close()

    def get_images(self) -> Sequence[NDArray[Any] | None]:
        """Return one RGB image per env, rendered in its worker."""
        if self.render_mode != "rgb_array":
            warnings.warn(f"render_mode is {self.render_mode}; images need 'rgb_array'.", stacklevel=2)
            return [None] * self.num_envs
        return self.env_method("render")

    def has_attr(self, attr_name: str) -> bool:
        """Return whether every env has this attribute."""
        return all(self._apply(has_attribute, None, attr_name))

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of each env.

        Raises:
            AttributeError: An env does not have it.
        """
        try:
            return self._apply(get_attribute, indices, attr_name)
        except WorkerFailed as failure:
            if failure.error_type == "AttributeError":
                raise AttributeError(str(failure)) from failure
            raise

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of each env (of its outermost wrapper, as SB3 does).

        Args:
            attr_name: Name of the attribute.
            value: Its new value.
            indices: Envs; all by default.
        """
        self._apply(set_attribute, indices, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of each env and return the results."""
        return self._apply(call_method, indices, method_name, *method_args, **method_kwargs)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return for each env whether a wrapper of this class is around it."""
        return self._apply(is_wrapped, indices, wrapper_class)

    def processor_seconds(self) -> float:
        """Return the processor time that the workers have used since they started, seconds."""
        return float(sum(dict(self._apply(processor_time, None)).values()))

    def _share_memory(self) -> None:
        _check_equal(self._pool.spaces)
        observation_space, action_space = self._pool.spaces[0]
        keys, shapes, dtypes = obs_space_info(observation_space)
        n, workers = len(self._pool.spaces), len(self._pool.shares)
        fields: dict[Hashable, tuple[tuple[int, ...], Any]] = {
            ("obs", key): ((n, *shapes[key]), dtypes[key]) for key in keys
        }
        fields |= {
            "actions": ((n, *(action_space.shape or ())), action_space.dtype),
            "rewards": ((n,), np.float64),
            "dones": ((n,), np.bool_),
            "status": ((n,), np.uint8),
            "running": ((workers,), np.int64),
            "ticks": ((workers,), np.int64),
        }
        arrays = self._pool.share(Layout.of(fields))
        self._obs = {key: arrays["obs", key] for key in keys}
        self._actions, self._status = arrays["actions"], arrays["status"]
        self._rewards, self._dones = arrays["rewards"], arrays["dones"]

    def _observations(self) -> VecEnvObs:
        return dict_to_obs(self.observation_space, {key: array.copy() for key, array in self._obs.items()})

    def _take_assignments(self) -> dict[int, bytes]:
        messages = {}
        for worker, share in enumerate(self._pool.shares):
            mine = {index: self._assigned[index] for index in share if index in self._assigned}
            if mine:
                messages[worker] = dump(("step", mine))
            for index, reset_kwargs in mine.items():
                self._pool.labels[index] = describe_reset(reset_kwargs)
        self._assigned = {}
        return messages

    def _note_reset(self, index: int, info: dict[str, Any]) -> None:
        self.reset_infos[index] = info
        if "condition_id" in info:
            self._pool.labels[index] = f"condition {info['condition_id']}"

    def _apply(self, function: Callable[..., Any], indices: VecEnvIndices, *args: Any, **kwargs: Any) -> list[Any]:
        """Return `function(env, *args, **kwargs)` for the given envs, in the given order."""
        chosen: Iterable[int] = range(len(self._pool.spaces)) if indices is None else self._get_indices(indices)
        order = [range(len(self._pool.spaces))[index] for index in chosen]
        names = {w: [i for i in order if i in share] for w, share in enumerate(self._pool.shares)}
        answers = self._pool.exchange(
            {w: dump(("apply", mine, function, args, kwargs)) for w, mine in names.items() if mine}
        )
        result = {index: value for w, values in answers.items() for index, value in zip(names[w], values, strict=True)}
        return [result[index] for index in order]


def _check_equal(spaces: Sequence[tuple[gym.Space[Any], gym.Space[Any]]]) -> None:
    """Check that all envs have the spaces of the first, and that those have a fixed shape.

    Raises:
        ValueError: They differ, or a space has no fixed shape.
    """
    for index, pair in enumerate(spaces):
        for kind, space, expected in zip(("observation", "action"), pair, spaces[0], strict=True):
            if space != expected:
                raise ValueError(f"env {index} has {kind} space {space}, env 0 has {expected}; they must agree.")
    observation, action = spaces[0]
    leaves = observation.spaces.values() if isinstance(observation, gym.spaces.Dict) else (observation,)
    for space in (*leaves, action):
        if space.shape is None or space.dtype is None:
            raise ValueError(f"The space {space} has no fixed shape; use Box, Discrete, MultiDiscrete or MultiBinary.")
