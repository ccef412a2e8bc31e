"""The source demonstration of DynaMimicGen: one success of the planner on the task's objects at rest."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from dynaforge.demos import Episode
from dynaforge.demos.episode_file import read_episode
from dynaforge.generators.dmp_segments import Reference
from dynaforge.generators.generator import PlannerOnly, make_env
from dynaforge.sim import Condition, Launch
from dynaforge.tasks import Task
from dynaforge.tasks.digest import task_digest
from dynaforge.tasks.view import yaw

SPEED_UNITS = ("m/s", "rad/s")
TRIES = 32


def at_rest(task: Task) -> Task:
    """Return a task in fixed physics whose conditions may have every speed down to zero."""
    space = task.conditions
    ranges = dict(space.ranges)
    for name in speeds(task):
        low, high = ranges[name]
        ranges[name] = (min(low, 0.0), max(high, 0.0))
    return replace(task.under(physics="fixed"), conditions=replace(space, ranges=ranges))


def speeds(task: Task) -> list[str]:
    """Return the fields of a task's conditions that are speeds, by their units."""
    return [name for name, unit in task.conditions.units.items() if unit in SPEED_UNITS]


def record_source(task: Task) -> Episode:
    """Record the source demonstration of a task; the same task has the same one in every process.

    It is the planner's first success in a fixed list of conditions: of the first 32 of the stream `train` those in
    which what rolls faces ahead, with all speeds set to zero, then with the least speeds that the task's conditions
    allow, for objects that are never at rest.

    Args:
        task: The task; its physics are fixed and its sensing ideal here, whatever its setting says.

    Raises:
        ValueError: The planner solves none of them; says how it failed.
    """
    still, planner = at_rest(task).under(sensing="ideal"), PlannerOnly()
    failures: dict[str, None] = {}
    env = make_env(planner, still)
    try:
        for condition in _conditions(task, still):
            episode = planner.attempt(env, condition)
            if episode.success:
                return episode
            failures[episode.failure] = None
    finally:
        env.close()
    raise ValueError(
        f"The generator dmp has no source demonstration of {task.name!r}: the planner solves none of its "
        f"conditions at rest or as slow as the task allows ({', '.join(failures)}). Give it a recorded one."
    )


def read_source(path: str | Path, task: Task) -> Episode:
    """Read a source demonstration from the file of an episode in a dataset.

    Args:
        path: The file, such as `data/can/episodes/ID.h5`.
        task: The task that it must be of.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is damaged or no success, or was recorded with another definition of the task.
    """
    episode = read_episode(Path(path))
    if episode.condition.task != task.name:
        raise ValueError(f"{path} is a recording of task {episode.condition.task!r}, not of {task.name!r}.")
    if episode.meta.get("task_hash") not in _digests(task):
        raise ValueError(
            f"{path} was recorded with another definition of task {task.name!r}, so it is no source demonstration for "
            "this one. Record one with `dynaforge collect --generator planner_only --keep-failures`, or leave it out."
        )
    if not episode.success:
        raise ValueError(f"{path} is a failure ({episode.failure}); a source demonstration is a success.")
    return episode


def _digests(task: Task) -> set[str]:
    """Return the digests of a task in its setting and in fixed physics, as it is and at rest."""
    still = at_rest(task)
    return {task_digest(each) for each in (task, task.under(physics="fixed"), still, still.under(sensing="ideal"))}


def _conditions(task: Task, still: Task) -> Iterator[Condition]:
    space = task.conditions
    drawn = [
        condition for condition in islice(still.conditions.stream("train"), TRIES) if _faces_ahead(task, condition)
    ]
    for pace in (dict.fromkeys(speeds(task), 0.0), {name: _slowest(*space.ranges[name]) for name in speeds(task)}):
        for condition in drawn:
            values = dict(condition.values) | pace
            yield Condition(task.name, condition.seed, values[space.difficulty], values)


def _faces_ahead(task: Task, condition: Condition) -> bool:
    """Return whether all that is grasped along its heading is turned the way that it moves, as it must be at rest.

    The planner takes the x axis of what rests for its heading. That of a can may point back, and the source would then
    reach for the can from behind.
    """
    rolling = {reference.name for phase in task.phases if (reference := Reference.of(phase)).turns == "half"}
    starts = task.scene.starts(condition)
    for start in (starts[body.name] for body in task.scene.bodies if body.name in rolling):
        assert isinstance(start, Launch)
        angle = yaw(start.pose)
        ahead = start.velocity[:2] @ (math.cos(angle), math.sin(angle))
        if ahead < 0.9 * np.linalg.norm(start.velocity[:2]):
            return False
    return True


def _slowest(low: float, high: float) -> float:
    """Return the number nearest to zero in a range."""
    return min(max(low, 0.0), high)
