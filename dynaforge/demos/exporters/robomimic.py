"""robomimic's HDF5: `data/demo_<k>` with actions, rewards, dones, states, obs/<name>; `mask/<split>`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np

from dynaforge.demos.atomic import atomic_write
from dynaforge.demos.exporters.frames import Frames
from dynaforge.registration import env_id
from dynaforge.tasks import Task

FILE = "demos.hdf5"
VALID_EVERY = 10  # every tenth demonstration is for validation
GYM = 2  # robomimic's EnvType of Gym environments


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write `demos.hdf5`; returns the number of demonstrations.

    robomimic's policies act within [-1, 1], so actions are scaled to it; the attributes `action_low` and `action_high`
    of `data` undo that: a = low + (scaled + 1) / 2 * (high - low).
    """
    kept = list(episodes)
    if not kept:
        raise ValueError("There is no demonstration to export.")
    atomic_write(folder / FILE, lambda path: _write(path, task, kept))
    return len(kept)


def _write(path: Path, task: Task, episodes: list[Frames]) -> None:
    everything = np.concatenate([e.actions for e in episodes])
    low, high = everything.min(axis=0), everything.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    about = {"env_name": env_id(task.name), "type": GYM, "env_kwargs": {}}
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["total"] = len(everything)
        data.attrs["env_args"] = json.dumps(about)
        data.attrs["action_low"], data.attrs["action_high"] = low, low + span
        data.attrs["action_names"] = json.dumps(episodes[0].action_names)
        for k, episode in enumerate(episodes):
            demo = data.create_group(f"demo_{k}")
            demo.attrs["num_samples"] = len(episode)
            demo.attrs["episode"] = episode.id
            demo["actions"] = 2.0 * (episode.actions - low) / span - 1.0
            demo["rewards"] = episode.rewards
            demo["dones"] = np.arange(len(episode)) == len(episode) - 1
            demo["states"] = np.concatenate((episode.state, episode.object_state), axis=1)
            for name, column in {**episode.robot, **episode.objects}.items():
                demo[f"obs/{name}"] = column
            for camera, film in episode.images.items():
                demo.create_dataset(f"obs/{camera}_image", data=film, compression="gzip", compression_opts=1)
            if episode.points is not None:
                demo.create_dataset("obs/points", data=episode.points, compression="gzip", compression_opts=1)
        valid = [k for k in range(len(episodes)) if k % VALID_EVERY == VALID_EVERY - 1]
        train = [k for k in range(len(episodes)) if k not in valid]
        for split, members in (("train", train), ("valid", valid)):
            file[f"mask/{split}"] = np.array([f"demo_{k}" for k in members], dtype="S")
