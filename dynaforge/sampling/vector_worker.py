"""The worker side of the vectorised env: a process that builds its share of the envs and steps them on command.

Kept free of torch and Stable-Baselines3, which would cost every worker seconds and hundreds of megabytes. Commands
and answers are short byte strings over a pipe, one answer per command; arrays lie in one shared block of memory.
"""

from __future__ import annotations

import mmap
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from multiprocessing import connection, reduction
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynaforge.sampling.processes import begin_worker

# What a step did to an env, one byte per env, in the shared array "status".
STEPPED, TRUNCATED, IDLE, STARTED = range(4)
# Commands without arguments; every other command is a pickled tuple (name, *arguments).
STEP, CLOSE = b"step", b"close"
# First byte of an answer: nothing to say, a pickled payload, a pickled failure.
EMPTY, PAYLOAD, FAILURE = b".", b"+", b"!"
# Value in the shared array "running" for a worker that is in none of its envs.
NO_ENV = -1

SharedArrays = dict[Hashable, NDArray[Any]]
Info = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Layout:
    """Where each array lies in the shared block.

    Attributes:
        fields: Per array its name, shape, dtype string and byte offset. An observation leaf is named ("obs", key).
        size: Bytes of the whole block.
    """

    fields: tuple[tuple[Hashable, tuple[int, ...], str, int], ...]
    size: int

    @staticmethod
    def of(arrays: Mapping[Hashable, tuple[tuple[int, ...], Any]]) -> Layout:
        """Place arrays, given as name -> (shape, dtype), one after the other on cache-line borders."""
        fields, offset = [], 0
        for name, (shape, given) in arrays.items():
            dtype = np.dtype(given)
            fields.append((name, shape, dtype.str, offset))
            offset += -(-int(np.prod(shape, dtype=np.int64)) * dtype.itemsize // 64) * 64
        return Layout(tuple(fields), max(offset, 64))

    def map(self, descriptor: int) -> SharedArrays:
        """Map the open file `descriptor`, at least `size` bytes long, and return its arrays by name."""
        block = mmap.mmap(descriptor, self.size)
        return {name: np.ndarray(shape, dtype, block, offset) for name, shape, dtype, offset in self.fields}


def get_attribute(env: gym.Env[Any, Any], name: str) -> Any:
    """Return an attribute of the env or of what it wraps."""
    return env.get_wrapper_attr(name)


def has_attribute(env: gym.Env[Any, Any], name: str) -> bool:
    """Return whether the env or what it wraps has an attribute."""
    try:
        env.get_wrapper_attr(name)
    except AttributeError:
        return False
    return True


def set_attribute(env: gym.Env[Any, Any], name: str, value: Any) -> None:
    """Set an attribute of the outermost wrapper, as SB3's own vectorised envs do.

    Args:
        env: The env.
        name: Name of the attribute.
        value: Its new value.
    """
    setattr(env, name, value)


def call_method(env: gym.Env[Any, Any], name: str, *args: Any, **kwargs: Any) -> Any:
    """Call a method of the env or of what it wraps."""
    return env.get_wrapper_attr(name)(*args, **kwargs)


def is_wrapped(env: gym.Env[Any, Any], wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]]) -> bool:
    """Return whether a wrapper of this class is around the env."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, wrapper_class):
            return True
        env = env.env
    return False


class EnvRunner:
    """Runs the envs of one worker and tracks what each of them is doing.

    Args:
        envs: The worker's envs; `envs[i]` has the global index `first + i`.
        arrays: The shared arrays of all envs.
        worker: Index of the worker.
        first: Global index of the worker's first env.
    """

    def __init__(self, envs: Sequence[gym.Env[Any, Any]], arrays: SharedArrays, *, worker: int, first: int) -> None:
        self._envs = envs
        self._worker = worker
        self._first = first
        self._park = False
        self._idle = [False] * len(envs)
        self._begun = [False] * len(envs)
        self._tick = 0
        self._obs = [(name[1], array) for name, array in arrays.items() if isinstance(name, tuple)]
        self._actions, self._rewards, self._dones = arrays["actions"], arrays["rewards"], arrays["dones"]
        self._status, self._running, self._ticks = arrays["status"], arrays["running"], arrays["ticks"]
        self._commands: dict[str, Callable[..., Any]] = {
            "step": self.step,
            "reset": self.reset,
            "park": self.park,
            "apply": self.apply,
        }

    def answer(self, message: bytes) -> bytes:
        """Execute one command and return its answer; an exception is an answer too and names the env it arose in."""
        try:
            if message == STEP:
                result = self.step({})
            else:
                name, *arguments = pickle.loads(message)
                result = self._commands[name](*arguments)
            answer = EMPTY if result is None else PAYLOAD + _dump_fast(result)
        except Exception as error:  # noqa: BLE001  the process border: the parent raises it again, nothing is swallowed
            index = int(self._running[self._worker])
            answer = describe_failure(error, None if index == NO_ENV else index)
        self._running[self._worker] = NO_ENV
        return answer

    def step(self, assigned: Mapping[int, Info]) -> tuple[dict[int, Info], dict[int, Info]] | None:
        """Advance every env by one step; the envs in `assigned` are reset with those arguments instead.

        Returns:
            Step infos that are not empty and reset infos, each by global env index; None if there are neither.
        """
        infos: dict[int, Info] = {}
        resets: dict[int, Info] = {}
        for local, index in enumerate(range(self._first, self._first + len(self._envs))):
            if index in assigned or (self._idle[local] and not self._park):
                resets[index] = self._start(local, assigned.get(index, {}))
                self._write(index, 0.0, False, STARTED)
            elif self._idle[local]:
                self._write(index, 0.0, False, IDLE)
            else:
                self._step_env(local, infos, resets)
        return (infos, resets) if infos or resets else None

    def reset(self, arguments: Sequence[Info]) -> list[Info]:
        """Reset every env with its own arguments and return the reset infos."""
        return [self._start(local, kwargs) for local, kwargs in enumerate(arguments)]

    def park(self, flag: bool) -> None:
        """Choose what follows an episode's end: idling (True) or an automatic reset.

        With parking, envs that were never reset idle as well; without it, an idle env is reset at the next step.
        """
        self._park = flag
        if flag:
            self._idle = [idle or not begun for idle, begun in zip(self._idle, self._begun, strict=True)]

    def apply(self, indices: Sequence[int], function: Callable[..., Any], args: Any, kwargs: Any) -> list[Any]:
        """Return `function(env, *args, **kwargs)` for some envs.

        Args:
            indices: Global indices of the envs.
            function: What to call.
            args: Its arguments after the env.
            kwargs: Its keyword arguments.
        """
        results = []
        for index in indices:
            self._enter(index)
            results.append(function(self._envs[index - self._first], *args, **kwargs))
        return results

    def _step_env(self, local: int, infos: dict[int, Info], resets: dict[int, Info]) -> None:
        index = self._first + local
        self._enter(index)
        observation, reward, terminated, truncated, info = self._envs[local].step(self._actions[index].copy())
        done = terminated or truncated
        self._write(index, reward, done, TRUNCATED if truncated and not terminated else STEPPED)
        if done:
            # A copy: the reset below may reuse the env's buffer.
            info = {**info, "terminal_observation": deepcopy(observation)}
        if done and not self._park:
            resets[index] = self._start(local, {})
        else:
            self._write_observation(index, observation)
            self._idle[local] = done
        if info:
            infos[index] = info

    def _start(self, local: int, reset_kwargs: Info) -> Info:
        index = self._first + local
        self._enter(index)
        observation, info = self._envs[local].reset(**reset_kwargs)
        self._write_observation(index, observation)
        self._begun[local], self._idle[local] = True, False
        return info

    def _enter(self, index: int) -> None:
        # Read by the parent when this process dies or hangs.
        self._tick += 1
        self._running[self._worker] = index
        self._ticks[self._worker] = self._tick

    def _write(self, index: int, reward: Any, done: bool, status: int) -> None:
        self._rewards[index] = reward
        self._dones[index] = done
        self._status[index] = status

    def _write_observation(self, index: int, observation: Any) -> None:
        for key, array in self._obs:
            array[index] = observation if key is None else observation[key]


def describe_failure(error: BaseException, index: int | None) -> bytes:
    """Turn an exception of an env into an answer; plain text, since exceptions may not pickle."""
    text = "".join(traceback.format_exception(error))
    return FAILURE + pickle.dumps((index, type(error).__name__, str(error), text))


def run_worker(pipe: connection.Connection[Any, Any], worker: int, first: int) -> None:
    """Serve commands until told to close or until the parent is gone. The body of a worker process.

    Args:
        pipe: The worker's end; brings pickled env functions, then layout and file descriptor, then commands.
        worker: Index of the worker.
        first: Global index of its first env.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    begin_worker()
    envs: list[gym.Env[Any, Any]] = []
    try:
        pipe.send_bytes(_build(pickle.loads(pipe.recv_bytes()), envs, first=first))
        message = pipe.recv_bytes()
        if message == CLOSE:
            return
        layout: Layout = pickle.loads(message)
        descriptor = reduction.recv_handle(pipe)
        arrays = layout.map(descriptor)
        os.close(descriptor)
        runner = EnvRunner(envs, arrays, worker=worker, first=first)
        while (message := pipe.recv_bytes()) != CLOSE:
            pipe.send_bytes(runner.answer(message))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # the parent is gone, or gave up while this worker was starting
    finally:
        for env in envs:
            env.close()


def _build(pickled_fns: Sequence[bytes], envs: list[gym.Env[Any, Any]], *, first: int) -> bytes:
    """Build the envs into `envs`; answer with each one's spaces, or with the first failure."""
    try:
        for data in pickled_fns:
            env = pickle.loads(data)()
            if not isinstance(env, gym.Env):
                raise TypeError(f"The env function returned {type(env).__name__}, expected a gymnasium.Env.")
            envs.append(env)
        answer = PAYLOAD + dump([(env.observation_space, env.action_space) for env in envs])
    except Exception as error:  # noqa: BLE001  the process border: the parent raises it again, nothing is swallowed
        return describe_failure(error, min(first + len(envs), first + len(pickled_fns) - 1))
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(1)
    return answer


def dump(value: Any) -> bytes:
    """Pickle by value where that is needed: closures, lambdas, classes of the main script."""
    return bytes(cloudpickle.dumps(value))


def _dump_fast(value: Any) -> bytes:
    try:
        return pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError):  # closures and local classes
        return dump(value)
