"""Minari's local storage: T + 1 observations, T actions, and their env."""

from __future__ import annotations

import contextlib
import copy
import os
import warnings
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium as gym
import minari
import numpy as np
from minari.data_collector import EpisodeBuffer
from numpy.typing import NDArray

from dynaforge.demos.exporters.frames import CONTACTS, STATE_NAMES, Floats, Frames, env_arguments_of, env_of
from dynaforge.demos.replay import Replayer
from dynaforge.sim import SceneState
from dynaforge.tasks import Task
from dynaforge.tasks.action import JOINTS, without_jumps

ROOT = "MINARI_DATASETS_PATH"


def dataset_id(task: Task) -> str:
    """Return the name of the dataset, as `minari.load_dataset` takes it."""
    return f"dynaforge/{task.name}/demonstrations-v0"


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write below the folder, which is then a `MINARI_DATASETS_PATH`, and return the number of demonstrations.

    An observation is the state of robot and objects. The one after the last action is not recorded, so it is simulated
    again. `infos` contain phase, gate, contact and joint velocities; apart from the velocities, their last row repeats
    that of the last action.

    Args:
        folder: Where to write.
        task: The task.
        episodes: What to write.

    Raises:
        ValueError: There is no demonstration, or one cannot be simulated again.
    """
    remaining = iter(episodes)
    first = list(islice(remaining, 1))  # a list, so that `_buffers` can free its memory
    if not first:
        raise ValueError("There is no demonstration to export.")
    metadata = _metadata(task, first[0])
    sizes = (_rows(first[0]).shape[1], first[0].actions.shape[1])
    spaces = [gym.spaces.Box(-np.inf, np.inf, (size,), np.float32) for size in sizes]
    env = gym.Env[Any, Any]()  # not the env itself, which would start physics: only its spec is stored
    env.spec = _spec(task, first[0])
    replayer = Replayer(task)
    try:
        with _rooted(folder), warnings.catch_warnings():
            warnings.filterwarnings("ignore", r"`\w+` is set to None|env_spec is None", UserWarning)
            dataset = minari.create_dataset_from_buffers(
                dataset_id(task),
                _buffers(first, remaining, replayer),
                env,
                observation_space=spaces[0],
                action_space=spaces[1],
                data_format="hdf5",
                algorithm_name="dynaforge",
                description=f"{task.instruction}. {task.motion} {task.goal}",
            )
    finally:
        replayer.close()
    dataset.storage.update_metadata(metadata)
    return int(dataset.total_episodes)


@contextlib.contextmanager
def _rooted(folder: Path) -> Iterator[None]:
    """Make Minari write below a folder."""
    before = os.environ.get(ROOT)
    os.environ[ROOT] = str(folder.resolve())
    try:
        yield
    finally:
        if before is None:
            del os.environ[ROOT]
        else:
            os.environ[ROOT] = before


def _spec(task: Task, frames: Frames) -> gym.envs.registration.EnvSpec | None:
    """Return the spec from which `recover_environment` makes the env; None for a task without a registered env."""
    spec = copy.deepcopy(gym.registry.get(env_of(task)))
    if spec is not None:
        spec.kwargs |= env_arguments_of(task, frames.layout)
    return spec


def _metadata(task: Task, frames: Frames) -> dict[str, Any]:
    names = [*STATE_NAMES, *(f"privileged_{name}" for name in frames.object_names if frames.privileged)]
    return {
        "instruction": task.instruction,
        "observation_names": names,
        "action_names": list(frames.action_names),
        "phase_names": [phase.name for phase in task.phases],
        "info_names": {"contact": list(CONTACTS), "dq": list(JOINTS)},
    }


def _buffers(first: list[Frames], remaining: Iterator[Frames], replayer: Replayer) -> Iterator[EpisodeBuffer]:
    """Yield the buffers of all episodes, and keep none of these in memory while the next is read."""
    k, waiting = 0, first
    while waiting:
        yield _buffer(k, waiting.pop(), replayer)
        waiting += islice(remaining, 1)
        k += 1


def _buffer(k: int, frames: Frames, replayer: Replayer) -> EpisodeBuffer:
    rows = _rows(frames)
    for state in replayer.states(frames.episode):
        last = state
    n = len(frames)
    return EpisodeBuffer(
        id=k,
        seed=frames.episode.condition.seed,
        observations=np.vstack((rows, _row(last, frames, rows[-1]))),
        actions=frames.actions,
        rewards=frames.rewards.tolist(),
        terminations=[step == n - 1 for step in range(n)],
        truncations=[False] * n,
        infos={
            "phase": _with_last_repeated(frames.phase),
            "gate": _with_last_repeated(frames.gate),
            "contact": _with_last_repeated(frames.contact),
            "dq": np.vstack((frames.robot["dq"], last.dq)).astype(np.float32),
        },
    )


def _with_last_repeated(rows: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate((rows, rows[-1:]))


def _rows(frames: Frames) -> Floats:
    return np.concatenate((frames.state, frames.object_state), axis=1) if frames.privileged else frames.state


def _row(state: SceneState, frames: Frames, before: Floats) -> Floats:
    """Lay a state out as the rows of `state` and `object_state`; quaternions keep the sign of the row before."""
    bodies = state.objects.items()
    objects = {f"{name}_{column}": value for name, body in bodies for column, value in body.columns.items()}
    parts = [("", state.ee.position), ("_quat_wxyz", state.ee.quat_wxyz), ("", np.array([state.width])), ("", state.q)]
    parts += [(name, objects[name]) for name in frames.objects if frames.privileged]
    row, start = [], 0
    for name, part in parts:
        previous = before[start : start + len(part)]
        row.append(without_jumps(np.stack((previous, part)))[1] if name.endswith("_quat_wxyz") else part)
        start += len(part)
    return np.concatenate(row).astype(np.float32)
