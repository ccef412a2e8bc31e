"""The pairs of generator and task whose cost `dynaforge table2` tells: what each takes, and what is known of it."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, product
from pathlib import Path

from dynaforge.cli.arguments.table2 import GRPO, TRAINED
from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.cli.evaluate import generator_of
from dynaforge.generators import Generator
from dynaforge.reports.costs import Missing
from dynaforge.reports.stored_evaluation import StoredEvaluation, origin_of, read_evaluations
from dynaforge.sim import Condition
from dynaforge.tasks import Task
from dynaforge.training.training_cost import training_cost

MEASURED = "measured"
"""Folder below --out with what the command measured, a file for each task and generator."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A generator on a task.

    Attributes:
        task: The task.
        name: Name of the generator.
        preparation: CPU-hours before its first attempt.
        generator: The generator; None if its attempts were given, and it need not be made.
        measured: What is known of its attempts; None if they are yet to be made.
        path: The file of its attempts, where this command makes them.
    """

    task: Task
    name: str
    preparation: float
    generator: Generator | None
    measured: StoredEvaluation | None
    path: Path


def planned(options: argparse.Namespace) -> tuple[list[Pair], Missing]:
    """Return every pair that the options ask for, and why there are no others.

    Raises:
        ValueError: What was measured or trained does not fit the tasks, or --policy does not, or nothing can be done.
    """
    given = {(found.generator, found.task): found for found in read_evaluations(options.measured)}
    pairs: list[Pair] = []
    missing: dict[tuple[str, str], str] = {}
    for task, name in product(chosen_tasks(options), options.generator):
        measured, generator, hours = given.get((name, task.name)), None, 0.0
        path = Path(options.out) / MEASURED / f"{task.name}-{name}.json"
        if measured is None or name not in TRAINED:
            try:
                generator, hours = _made(name, task, options)
            except ValueError as reason:
                if options.policy:
                    raise
                missing[name, task.name] = str(reason)
                continue
        if name in TRAINED:
            hours = _training_hours(options, task, GRPO if name == GRPO else options.variant)
        if measured is None and generator is not None and path.exists():
            measured = _measured_earlier(path, task, generator, options)
        if measured is not None:
            measured.check(task)
        pairs.append(Pair(task=task, name=name, preparation=hours, generator=generator, measured=measured, path=path))
    if not pairs:
        raise ValueError(f"None of the generators does any of the tasks: {'; '.join(missing.values())}")
    return pairs, missing


def blocks(task: Task, options: argparse.Namespace) -> Iterator[Iterator[Condition]]:
    """Yield the conditions of each block that is attempted."""
    for block in range(options.seeds):
        yield islice(task.conditions.stream(options.stream, block), options.attempts)


def _made(name: str, task: Task, options: argparse.Namespace) -> tuple[Generator, float]:
    """Return a new generator, and the CPU-hours that making it took: it may record a source demonstration."""
    if name == GRPO:
        raise ValueError(f"the attempts of {GRPO} are those of `dynaforge table1`; give their files as --measured")
    begin = time.process_time()
    generator = generator_of(name, task, options)
    return generator, (time.process_time() - begin) / 3600.0


def _training_hours(options: argparse.Namespace, task: Task, variant: str | None) -> float:
    try:
        return training_cost(options.training, task, variant=variant).mean
    except ValueError as error:
        raise ValueError(f"--training: {error}{' Name it as --variant.' if 'choose' in str(error) else ''}") from error


def _measured_earlier(
    path: Path, task: Task, generator: Generator, options: argparse.Namespace
) -> StoredEvaluation | None:
    """Return what an interrupted call of the same command measured.

    Raises:
        ValueError: The file tells of other conditions or of another generator of that name.
    """
    (found,) = read_evaluations([path])
    ids = tuple(condition.id for block in blocks(task, options) for condition in block)
    if found.conditions != ids or found.origin != origin_of(generator):
        raise ValueError(
            f"--out {options.out} holds {path.relative_to(options.out)}, measured on other conditions or with another "
            "policy. Choose another folder, or repeat the command that made it."
        )
    return found
