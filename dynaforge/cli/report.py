"""`dynaforge report`: films and film strips that show what the figures mean."""

from __future__ import annotations

import argparse
import contextlib
import json
from itertools import islice

from dynaforge.cli.arguments.setting import chosen_parts
from dynaforge.cli.arguments.tasks import chosen_task
from dynaforge.demos import Episode
from dynaforge.files.atomic import atomic_write, make_folder
from dynaforge.generators import Generator, PlannerOnly, make_generator
from dynaforge.generators.by_name import setting_line
from dynaforge.generators.generator import make_env
from dynaforge.reports.extras import load_extra
from dynaforge.reports.motivation import film, film_strip, first_telling, shoot
from dynaforge.sim import Condition
from dynaforge.tasks import Stream, Task

STREAM: Stream = "val"
REPLAY = "replay"
LABELS = {"planner_only": "planner only", REPLAY: "replay, object driven", "residual": "with residual"}


def run(options: argparse.Namespace) -> int:
    """Find the condition, film the generators on it, and write film, strip and outcomes; return 1 without a condition.

    Raises:
        ValueError: No policy is shipped for the task, or it does not fit.
        ImportError: What draws and encodes, of the `[report]` extra, is missing.
    """
    for package in ("PIL.Image", "matplotlib", "imageio_ffmpeg"):
        load_extra(package)
    task = chosen_task(options)
    try:
        residual = make_generator("residual", task, policy=options.policy, chosen=chosen_parts(options))
    except ValueError as error:
        raise ValueError(f"--policy: {error}" if options.policy else str(error)) from error
    replay = _replay(task)
    print(f"{task.name}: {setting_line(task, [residual])}")
    make_folder(options.out)
    conditions = islice(task.conditions.stream(STREAM), options.conditions)
    found = first_telling(task, PlannerOnly(), residual, conditions)
    if found is None:
        print(
            f"The planner fails none of the first {options.conditions} conditions of {STREAM} that the residual solves."
        )
        return 1
    index, failed, solved = found
    told = f"condition {index} of {STREAM}, {_difficulty(task, failed)}"
    print(f"{told}: the first that the planner fails ({failed.failure}) and the residual solves")
    replayed = None if replay is None else _attempt(task, replay, failed.condition)
    _write(options, task, [episode for episode in (failed, replayed, solved) if episode], told)
    return 0


def _difficulty(task: Task, episode: Episode) -> str:
    space = task.conditions
    return f"{space.difficulty} {episode.difficulty:.2f} {space.units.get(space.difficulty, '')}".rstrip()


def _replay(task: Task) -> Generator | None:
    """Return the generator that replays, its object as fast as the condition says; None, with a line why, if not."""
    try:
        return make_generator(REPLAY, task, object_speed="task")
    except ValueError as error:
        print(f"replay is left out: {error}")
        return None


def _attempt(task: Task, generator: Generator, condition: Condition) -> Episode | None:
    """Return an attempt; None, with a line that says so, if it ended before anything moved."""
    with contextlib.closing(make_env(generator, task)) as env:
        episode = generator.attempt(env, condition)
    if not len(episode):
        print(f"{generator.name} is left out: {episode.failure}.")
    return episode if len(episode) else None


def _write(options: argparse.Namespace, task: Task, episodes: list[Episode], told: str) -> None:
    labels = [LABELS.get(episode.generator.partition("-")[0], episode.generator) for episode in episodes]
    shots = shoot(task, zip(labels, episodes, strict=True))
    outcomes = [
        {
            "generator": shot.episode.generator,
            "outcome": str(shot.episode.outcome),
            "duration": shot.episode.duration,
            "peak_force": float(shot.forces.max()),
        }
        for shot in shots
    ]
    about = {"command": options.command, "task": task.name, "condition": episodes[0].condition.to_dict()}
    files = {
        "motivation.mp4": film(shots),
        "motivation.png": film_strip(shots, title=f"{task.env_name}, {told}", n=options.frames),
        "motivation.json": json.dumps(about | {"attempts": outcomes}, indent=1).encode() + b"\n",
    }
    for name, content in files.items():
        atomic_write(options.out / name, content)
    for shot in shots:
        print(f"{shot.label:<22} {shot.verdict}, at most {shot.forces.max():.0f} N")
    print(*(f"written to {options.out / name}" for name in files), sep="\n")
