"""Minari's local storage: T + 1 observations, T actions."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import gymnasium as gym
import minari
import numpy as np
from minari.data_collector import EpisodeBuffer

from dynaforge.demos.exporters.frames import Floats, Frames, without_jumps
from dynaforge.demos.replay import Replayer
from dynaforge.geometry import Array
from dynaforge.sim import SceneState
from dynaforge.tasks import Task


def dataset_id(task: Task) -> str:
    """Name of the dataset, as `minari.load_dataset` takes it."""
    return f"dynaforge/{task.name}/demonstrations-v0"


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write below the folder, which is then a `MINARI_DATASETS_PATH`; returns the number of demonstrations.

    An observation is the robot's and the objects' state; the one after the last action, which a recording does not
    hold, is simulated again.

    Raises:
        ValueError: There is no demonstration, or one cannot be simulated again.
    """
    replayer = Replayer(task)
    buffers = [_buffer(k, episode, replayer) for k, episode in enumerate(episodes)]
    replayer.close()
    if not buffers:
        raise ValueError("There is no demonstration to export.")
    sizes = [np.shape(getattr(buffers[0], name))[1] for name in ("observations", "actions")]
    spaces = [gym.spaces.Box(-np.inf, np.inf, (size,), np.float32) for size in sizes]
    before = os.environ.get("MINARI_DATASETS_PATH")
    os.environ["MINARI_DATASETS_PATH"] = str(folder.resolve())
    try:
        minari.create_dataset_from_buffers(
            dataset_id(task), buffers, observation_space=spaces[0], action_space=spaces[1],
            algorithm_name="dynaforge", description=f"{task.motion} {task.goal}", data_format="hdf5",
        )  # fmt: skip
    finally:
        if before is None:
            del os.environ["MINARI_DATASETS_PATH"]
        else:
            os.environ["MINARI_DATASETS_PATH"] = before
    return len(buffers)


def _buffer(k: int, frames: Frames, replayer: Replayer) -> EpisodeBuffer:
    rows = np.concatenate((frames.state, frames.object_state), axis=1)
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
    )


def _row(state: SceneState, frames: Frames, before: Floats) -> Floats:
    """Lay a state out as the rows of `state` and `object_state`; quaternions keep the sign they had before."""
    objects: dict[str, Array] = {}
    for name, body in state.objects.items():
        objects |= {
            f"{name}_position": body.pose.position, f"{name}_quat_wxyz": body.pose.quat_wxyz,
            f"{name}_velocity": body.velocity, f"{name}_angular_velocity": body.angular_velocity,
        }  # fmt: skip
    parts = [("", state.ee.position), ("_quat_wxyz", state.ee.quat_wxyz), ("", np.array([state.width])), ("", state.q)]
    parts += [(name, objects[name]) for name in frames.objects]
    row, at = [], 0
    for name, part in parts:
        held = before[at : at + len(part)]
        row.append(without_jumps(np.stack((held, part)))[1] if name.endswith("_quat_wxyz") else part)
        at += len(part)
    return np.concatenate(row).astype(np.float32)
