"""robomimic's HDF5: `data/demo_<k>` with actions, rewards, dones, obs/<name>, next_obs/<name>; `mask/<split>`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.exporters.frames import ROBOT_NAMES, Floats, Frames, axes_of, env_arguments_of, env_of
from dynaforge.tasks import Task

FILE = "demos.hdf5"
VALID_EVERY = 10  # every tenth demonstration is for validation
GYM = 2  # robomimic's EnvType of Gym environments
PRIVILEGED = "privileged_"
COMPRESSION = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write `demos.hdf5` and return the number of demonstrations.

    robomimic's policies act within [-1, 1], so actions are scaled to that range; the attributes `action_low` and
    `action_high` of `data` undo it: a = low + (scaled + 1) / 2 * (high - low).

    Episodes are written one by one, since the pictures of all may not fit into memory, and actions at the end, once
    their range is known.

    Args:
        folder: Where to write.
        task: The task.
        episodes: What to write.

    Raises:
        ValueError: There is no demonstration.
    """
    actions: list[Floats] = []
    metadata: dict[str, Any] = {}
    with h5py.File(folder / FILE, "w") as file:
        data = file.create_group("data")
        for episode in episodes:  # not enumerate(episodes), which keeps the last one in memory
            metadata = metadata or _metadata(task, episode)
            _write_demo(data.create_group(f"demo_{len(actions)}"), episode, task.instruction)
            actions.append(episode.actions)
            del episode  # free its memory before the next is read
        if not actions:
            raise ValueError("There is no demonstration to export.")
        everything = np.concatenate(actions)
        low, high = everything.min(axis=0), everything.max(axis=0)
        span = np.where(high > low, high - low, 1.0)
        for k, rows in enumerate(actions):
            data[f"demo_{k}/actions"] = 2.0 * (rows - low) / span - 1.0
        data.attrs["total"] = len(everything)
        data.attrs["action_low"], data.attrs["action_high"] = low, low + span
        for name, value in metadata.items():
            data.attrs[name] = value if isinstance(value, str) else json.dumps(value)
        for split, members in _splits(len(actions)).items():
            file[f"mask/{split}"] = np.array([f"demo_{k}" for k in members], dtype="S")
    return len(actions)


def _metadata(task: Task, episode: Frames) -> dict[str, Any]:
    """Describe the columns, the instruction, and the env of the unscaled actions."""
    env = {"env_name": env_of(task), "type": GYM, "env_kwargs": env_arguments_of(task, episode.layout)}
    names = {**ROBOT_NAMES, **{PRIVILEGED + key: axes_of(key) for key in _truth(episode)}}
    return {
        "env_args": env,
        "action_names": episode.action_names,
        "observation_names": names,
        "phase_names": [phase.name for phase in task.phases],
        "instruction": task.instruction,
    }


def _splits(n: int) -> dict[str, list[int]]:
    """Choose demonstrations for training and for validation; a single one serves as both."""
    valid = list(range(VALID_EVERY - 1, n, VALID_EVERY)) or [n - 1]
    return {"train": [k for k in range(n) if k not in valid] or valid, "valid": valid}


def _truth(episode: Frames) -> Mapping[str, Floats]:
    return episode.objects if episode.privileged else {}


def _write_demo(demo: h5py.Group, episode: Frames, instruction: str) -> None:
    demo.attrs["num_samples"] = len(episode)
    demo.attrs["episode"] = episode.id
    demo.attrs["ep_meta"] = json.dumps({"lang": instruction})  # where robomimic looks for a sentence
    demo["rewards"] = episode.rewards
    demo["dones"] = np.arange(len(episode)) == len(episode) - 1
    demo["states"] = np.concatenate((episode.state, *_truth(episode).values()), axis=1)
    demo["phase"], demo["gate"], demo["contact"] = episode.phase, episode.gate, episode.contact
    for name, column in episode.robot.items():
        _observe(demo, name, column)
    for name, column in _truth(episode).items():
        _observe(demo, PRIVILEGED + name, column)
        if not episode.images and episode.points is None:  # low-dimensional learners read it by its plain name
            for group in ("obs", "next_obs"):
                demo[f"{group}/{name}"] = demo[f"{group}/{PRIVILEGED}{name}"]
    for camera, film in episode.images.items():
        _observe(demo, f"{camera}_image", film, chunk=True)
    for camera, depth in episode.depths.items():
        _observe(demo, f"{camera}_depth", (depth[..., None] * 1e-4).astype(np.float32), chunk=True)
    if episode.points is not None:
        _observe(demo, "points", episode.points, chunk=True)


def _observe(demo: h5py.Group, name: str, rows: NDArray[Any], *, chunk: bool = False) -> None:
    """Write the observations before each action, and those after it: the same rows, one later, the last repeated.

    No learner reads the observation after the last action, and none was recorded. Pictures are not stored twice: those
    after an action are a virtual dataset of those before.
    """
    before = demo.create_dataset(
        f"obs/{name}", data=rows, **(COMPRESSION | {"chunks": (1, *rows.shape[1:])} if chunk else {})
    )
    if not chunk:
        demo[f"next_obs/{name}"] = np.concatenate((rows[1:], rows[-1:]))
        return
    source = h5py.VirtualSource(".", before.name, before.shape)
    after = h5py.VirtualLayout(before.shape, before.dtype)
    n = len(rows)
    after[: n - 1] = source[1:]
    after[n - 1] = source[n - 1]
    demo.create_virtual_dataset(f"next_obs/{name}", after)
