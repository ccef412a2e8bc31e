"""Hashes of one attempt at each task, by the planner alone and with the shipped policy.

Run as a script it prints trajectories.json, with the dynaforge of the interpreter that runs it.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Sequence
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.demos import Episode
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import PlannerOnly, ResidualGenerator
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import TASK_NAMES, get_task
from dynaforge.tasks.digest import task_digest

STORED = Path(__file__).with_name("trajectories.json")
GENERATORS = ("planner_only", "residual")
PACKAGES = ("pybullet", "pin", "coal", "toppra", "ruckig", "numpy", "scipy", "torch")
CONDITIONS = {"can": 1, "alarmclock": 1}  # place in stream val: the first one that the shipped policy wins; else 0


def shipped_policy(name: str) -> MlpPolicyFile:
    return MlpPolicyFile.load(asset_path(f"{name}/policy.safetensors"), task=name)


def attempt(name: str, generator: str) -> Episode:
    """Make the attempt at a task by one of `GENERATORS`, in an env of its own."""
    task, policy = get_task(name), shipped_policy(name)
    condition = next(islice(task.conditions.stream("val"), CONDITIONS.get(name, 0), None))
    made_by = PlannerOnly() if generator == "planner_only" else ResidualGenerator(policy, policy_hash=policy.digest)
    env = ResidualEnv(task)
    try:
        return made_by.attempt(env, condition)
    finally:
        env.close()


def summary(episode: Episode, columns: Sequence[str]) -> dict[str, Any]:
    """Return how an episode ended, and the hash of some of its columns at every control step."""
    digest = hashlib.sha256()
    for name in columns:
        array = episode.steps[name]
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return {
        "condition": episode.condition.id,
        "success": episode.success,
        "checkpoint": episode.checkpoint,
        "failure": episode.failure,
        "phase": episode.phase,
        "duration": episode.duration,
        "steps": len(episode),
        "sha256": digest.hexdigest(),
    }


def everything() -> dict[str, Any]:
    """Return what trajectories.json holds."""
    from arithmetic import TRAINING, fingerprints

    tasks: dict[str, Any] = {}
    for name in TASK_NAMES:
        episodes = {generator: attempt(name, generator) for generator in GENERATORS}
        columns = sorted(episodes["planner_only"].steps)
        tasks[name] = {"definition": task_digest(get_task(name)), "policy": shipped_policy(name).digest}
        tasks[name] |= {"columns": columns}
        tasks[name] |= {generator: summary(episode, columns) for generator, episode in episodes.items()}
    return {
        "platform": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "simd": np.show_config(mode="dicts")["SIMD Extensions"]["found"],
        "packages": {name: version(name) for name in PACKAGES},
        "arithmetic": fingerprints(TRAINING),
        "tasks": tasks,
    }


if __name__ == "__main__":
    print(json.dumps(everything(), indent=1))
