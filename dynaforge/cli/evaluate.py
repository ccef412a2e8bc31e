"""`dynaforge evaluate`: the demonstration generation rate of generators on the same stored conditions."""

from __future__ import annotations

import argparse
import time
from itertools import islice

from dynaforge.cli.arguments.setting import chosen_parts, setting_lines
from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.cli.engine import on_ray
from dynaforge.demos import Attempt
from dynaforge.evaluation import DgrReport, comparison_table, task_table
from dynaforge.generators import Generator, ResidualGenerator
from dynaforge.generators.by_name import make_generator, setting_line
from dynaforge.generators.collecting import Engine
from dynaforge.generators.measure import Until, ends_when_decided, measure, never
from dynaforge.generators.names import SETTINGS
from dynaforge.generators.ray_engine import run_attempts_on_ray
from dynaforge.reports.evaluation import BINS, gains_over_first, reports_of, write_evaluation, write_task_table
from dynaforge.tasks import Task


def run(options: argparse.Namespace) -> int:
    """Measure, print and store the results.

    Raises:
        GaveUp: A generator only raises, so that there is nothing to measure.
    """
    engine = run_attempts_on_ray if on_ray(options) else None
    tasks = chosen_tasks(options)
    planned = [(task, [generator_of(name, task, options) for name in options.generator]) for task in tasks]
    print(*setting_lines((task.name, setting_line(task, generators)) for task, generators in planned), sep="\n")
    out = options.out
    table: dict[str, list[DgrReport]] = {}
    started = time.monotonic()
    for task, generators in planned:
        measured: dict[str, list[Attempt]] = {}
        for generator in generators:
            until = ends_when_decided(next(iter(measured.values()))) if options.sequential and measured else never
            measured[generator.name] = _measured(task, generator, options, engine, until)
        reports = reports_of(task, measured)
        print(f"\n{task.name}: stream {options.stream}, {options.seeds} x {options.attempts} conditions")
        print(comparison_table(reports))
        gains = gains_over_first(task, measured, sequential=options.sequential)
        for gain in gains:
            print(gain.text)
        for report in reports:
            print(report.table())
        path = out if len(tasks) == 1 else out.with_stem(f"{out.stem}-{task.name}")
        write_evaluation(
            path,
            task,
            measured,
            reports=reports,
            gains=gains,
            policies={g.name: g.policy_origin for g in generators if isinstance(g, ResidualGenerator)},
            command=options.command,
        )
        print(f"written to {path}")
        table[task.name] = reports
    if len(tasks) > 1:
        minutes = (time.monotonic() - started) / 60
        print(f"\n{task_table(table)}\ntook {minutes:.1f} minutes")
        write_task_table(out, table, minutes=minutes, command=options.command)
        print(f"written to {out}")
    return 0


def generator_of(name: str, task: Task, options: argparse.Namespace) -> Generator:
    """Return the generator that the options describe.

    Args:
        name: Name of the generator.
        task: What it attempts.
        options: The options of the command, some of which are the generator's settings.

    Raises:
        ValueError: A residual policy is neither given nor shipped, or does not fit the task.
    """
    settings = {
        key: value
        for key in ("learner", "observations", *SETTINGS)
        if (value := getattr(options, key, None)) is not None
    }
    try:
        return make_generator(name, task, **settings, chosen=chosen_parts(options))
    except ValueError as error:
        raise ValueError(f"--policy: {error}" if "policy" in settings else str(error)) from error


def _measured(
    task: Task, generator: Generator, options: argparse.Namespace, engine: Engine | None, until: Until
) -> list[Attempt]:
    n_strata = BINS if options.strata else None
    blocks = (
        islice(task.conditions.stream(options.stream, block, n_strata=n_strata), options.attempts)
        for block in range(options.seeds)
    )
    total = options.seeds * options.attempts
    return measure(task, generator, blocks, total=total, workers=options.workers, engine=engine, until=until)
