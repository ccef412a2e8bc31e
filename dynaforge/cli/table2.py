"""`dynaforge table2`: what demonstrations of several generators cost, beside the paper's cost model."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.setting import setting_lines
from dynaforge.cli.engine import on_ray
from dynaforge.cli.table2_pairs import Pair, blocks, planned
from dynaforge.evaluation.costs import Cost
from dynaforge.files.atomic import make_folder
from dynaforge.generators.by_name import setting_line
from dynaforge.generators.collecting import Engine
from dynaforge.generators.measure import measure
from dynaforge.generators.ray_engine import run_attempts_on_ray
from dynaforge.reports.costs import CostTable, write_costs
from dynaforge.reports.evaluation import reports_of, write_evaluation
from dynaforge.reports.stored_evaluation import StoredEvaluation, origin_of, read_evaluations


def run(options: argparse.Namespace) -> int:
    """Measure what is missing, print and store the table.

    Raises:
        ValueError: As `planned`; nothing is measured then.
        GaveUp: A generator only raises, so that there is nothing to measure.
    """
    engine = run_attempts_on_ray if on_ray(options) else None
    pairs, missing = planned(options)
    print(*setting_lines((p.task.name, setting_line(p.task, [p.generator])) for p in pairs if p.generator), sep="\n")
    make_folder(options.out)
    costs = {}
    for pair in pairs:
        found = pair.measured or _measured(pair, options, engine)
        costs[pair.name, pair.task.name] = Cost(
            count=found.count, seconds=found.seconds, demos=options.demos, preparation=pair.preparation
        )
    tasks = tuple(dict.fromkeys([pair.task.name for pair in pairs] + [task for _, task in missing]))
    table = CostTable(tasks=tasks, generators=tuple(options.generator), costs=costs, missing=missing)
    print(f"\n{table.text()}\n")
    origin = {"measured": [str(path) for path in options.measured], "training": str(options.training or "")}
    for path in write_costs(options.out, table, command=options.command, origin=origin):
        print(f"written to {path}")
    return 0


def _measured(pair: Pair, options: argparse.Namespace, engine: Engine | None) -> StoredEvaluation:
    """Measure a generator on a task, and store it at once, so that an interruption costs no other pair."""
    assert pair.generator is not None
    task, generator, total = pair.task, pair.generator, options.seeds * options.attempts
    attempts = measure(task, generator, blocks(task, options), total=total, workers=options.workers, engine=engine)
    write_evaluation(
        pair.path,
        task,
        {pair.name: attempts},
        reports=reports_of(task, {pair.name: attempts}),
        gains=[],
        policies={pair.name: origin_of(generator)},
        command=options.command,
    )
    (found,) = read_evaluations([pair.path])
    print(f"{task.name}, {pair.name}: {found.count.rate:.1%} of {total}, {found.seconds:.2f} CPU-seconds an attempt")
    return found
