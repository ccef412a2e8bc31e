"""The pairs of generator and task whose cost `dynaforge table2` tells: what each takes, and what is known of it."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from itertools import product

from dynaforge.cli.arguments.table2 import TRAINED
from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.cli.evaluate import generator_of
from dynaforge.generators import Generator
from dynaforge.generators.names import GRPO
from dynaforge.generators.pairs import Pair
from dynaforge.reports.costs import Missing
from dynaforge.reports.stored_evaluation import StoredEvaluation, read_evaluations
from dynaforge.reports.table1_folder import pair_path
from dynaforge.tasks import Task
from dynaforge.training.matrix import refuse_links
from dynaforge.training.training_cost import training_cost

MEASURED = "measured"
"""Folder below --out with what the command measured, TASK/GENERATOR.json as in the folder of `dynaforge table1`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PricedPair:
    """A generator on a task.

    Attributes:
        task: The task.
        name: Name of the generator.
        preparation: CPU-hours before its first attempt.
        measured: What is known of its attempts; None if they are yet to be made.
        pair: What makes them; None if they were given.
    """

    task: Task
    name: str
    preparation: float
    measured: StoredEvaluation | None = None
    pair: Pair | None = None


def planned(options: argparse.Namespace) -> tuple[list[PricedPair], Missing]:
    """Return every pair that the options ask for, and why there are no others.

    Raises:
        ValueError: What was measured or trained does not fit the tasks, or --policy does not, or nothing can be done.
    """
    given = {(found.generator, found.task): found for found in read_evaluations(options.measured)}
    pairs: list[PricedPair] = []
    missing: dict[tuple[str, str], str] = {}
    for task, name in product(chosen_tasks(options), options.generator):
        measured, generator, hours = given.get((name, task.name)), None, 0.0
        if measured is not None:
            measured.check(task)
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
        pair = _pair(name, task, generator, options) if measured is None and generator is not None else None
        pairs.append(PricedPair(task=task, name=name, preparation=hours, measured=measured, pair=pair))
    if not pairs:
        raise ValueError(f"None of the generators does any of the tasks: {'; '.join(missing.values())}")
    return pairs, missing


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


def _pair(name: str, task: Task, generator: Generator, options: argparse.Namespace) -> Pair:
    """Return what measures a generator, once it is known that nothing else is stored in its place."""
    pair = Pair(
        task=task,
        row=name,
        generator=generator,
        stream=options.stream,
        blocks=options.seeds,
        attempts=options.attempts,
        path=pair_path(options.out / MEASURED, name, task.name),
    )
    refuse_links(pair.path, options.out)
    pair.stored()
    return pair
