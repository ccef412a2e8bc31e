"""`dynaforge table2`: what demonstrations of several generators cost, beside the paper's cost model."""

from __future__ import annotations

import argparse

from dynaforge.cli.arguments.setting import setting_lines
from dynaforge.cli.engine import on_ray
from dynaforge.cli.table2_pairs import PricedPair, planned
from dynaforge.evaluation.costs import Cost
from dynaforge.files.atomic import make_folder
from dynaforge.generators.by_name import setting_line
from dynaforge.generators.collecting import Engine
from dynaforge.generators.ray_engine import run_attempts_on_ray
from dynaforge.reports.costs import CostTable, write_costs
from dynaforge.reports.stored_evaluation import StoredEvaluation, read_evaluations


def run(options: argparse.Namespace) -> int:
    """Measure what is missing, print and store the table.

    Raises:
        ValueError: As `planned`; nothing is measured then.
        GaveUp: A generator only raises, so that there is nothing to measure.
    """
    engine = run_attempts_on_ray if on_ray(options) else None
    pairs, missing = planned(options)
    made = [(each.task.name, setting_line(each.task, [each.pair.generator])) for each in pairs if each.pair]
    print(*setting_lines(made), sep="\n")
    make_folder(options.out)
    costs = {}
    for each in pairs:
        found = each.measured or _measured(each, options, engine)
        costs[each.name, each.task.name] = Cost(
            count=found.count, seconds=found.seconds, demos=options.demos, preparation=each.preparation
        )
    tasks = tuple(dict.fromkeys([each.task.name for each in pairs] + [task for _, task in missing]))
    table = CostTable(tasks=tasks, generators=tuple(options.generator), costs=costs, missing=missing)
    print(f"\n{table.text()}\n")
    origin = {"measured": [str(path) for path in options.measured], "training": str(options.training or "")}
    for path in write_costs(options.out, table, command=options.command, origin=origin):
        print(f"written to {path}")
    return 0


def _measured(each: PricedPair, options: argparse.Namespace, engine: Engine | None) -> StoredEvaluation:
    """Measure a generator on a task; it is stored at once, so that an interruption costs no other pair."""
    assert each.pair is not None
    each.pair.measure(workers=options.workers, engine=engine)
    (found,) = read_evaluations([each.pair.path])
    found.check(each.task)
    print(f"{each.task.name}, {each.name}: {found.count.rate:.1%} of {found.count.n}, {found.seconds:.2f} CPU-seconds")
    return found
