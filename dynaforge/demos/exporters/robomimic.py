"""robomimic's HDF5: `data/demo_<k>` with actions, rewards, dones, states, obs/<name>; `mask/<split>`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np

from dynaforge.demos.atomic import atomic_write
from dynaforge.demos.exporters.frames import Floats, Frames
from dynaforge.registration import env_id
from dynaforge.tasks import Task

FILE = "demos.hdf5"
VALID_EVERY = 10  # every tenth demonstration is for validation
GYM = 2  # robomimic's EnvType of Gym environments


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write `demos.hdf5`; returns the number of demonstrations.

    robomimic's policies act within [-1, 1], so actions are scaled to it; the attributes `action_low` and `action_high`
    of `data` undo that: a = low + (scaled + 1) / 2 * (high - low).

    Raises:
        ValueError: There is no demonstration.
    """
    lengths: list[int] = []
    atomic_write(folder / FILE, lambda path: lengths.extend(_write(path, task, episodes)))
    return len(lengths)


def _write(path: Path, task: Task, episodes: Iterable[Frames]) -> list[int]:
    """Write episode by episode, since pictures of all may not fit into memory; actions at the end, once scaled."""
    actions: list[Floats] = []
    names: tuple[str, ...] = ()
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        for k, episode in enumerate(episodes):
            actions.append(episode.actions)
            names = episode.action_names
            _write_demo(data.create_group(f"demo_{k}"), episode)
        if not actions:
            raise ValueError("There is no demonstration to export.")
        everything = np.concatenate(actions)
        low, high = everything.min(axis=0), everything.max(axis=0)
        span = np.where(high > low, high - low, 1.0)
        for k, rows in enumerate(actions):
            data[f"demo_{k}/actions"] = 2.0 * (rows - low) / span - 1.0
        data.attrs["total"] = len(everything)
        data.attrs["env_args"] = json.dumps({"env_name": env_id(task.name), "type": GYM, "env_kwargs": {}})
        data.attrs["action_low"], data.attrs["action_high"] = low, low + span
        data.attrs["action_names"] = json.dumps(names)
        valid = [k for k in range(len(actions)) if k % VALID_EVERY == VALID_EVERY - 1]
        train = [k for k in range(len(actions)) if k not in valid]
        for split, members in (("train", train), ("valid", valid)):
            file[f"mask/{split}"] = np.array([f"demo_{k}" for k in members], dtype="S")
    return list(map(len, actions))


def _write_demo(demo: h5py.Group, episode: Frames) -> None:
    demo.attrs["num_samples"] = len(episode)
    demo.attrs["episode"] = episode.id
    demo["rewards"] = episode.rewards
    demo["dones"] = np.arange(len(episode)) == len(episode) - 1
    demo["states"] = np.concatenate((episode.state, episode.object_state), axis=1)
    for name, column in {**episode.robot, **episode.objects}.items():
        demo[f"obs/{name}"] = column
    for camera, film in episode.images.items():
        demo.create_dataset(f"obs/{camera}_image", data=film, compression="gzip", compression_opts=1)
    if episode.points is not None:
        demo.create_dataset("obs/points", data=episode.points, compression="gzip", compression_opts=1)
