"""`dynaforge compare`: train variants on tasks with several seeds, evaluate all on the same conditions, report."""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path

from dynaforge.cli.arguments.setting import chosen_parts, setting_lines
from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.cli.engine import on_ray
from dynaforge.files.atomic import make_folder
from dynaforge.reports import write_comparison
from dynaforge.sampling.processes import usable_cores
from dynaforge.training.comparison import Comparison
from dynaforge.training.comparison_table import comparison_table
from dynaforge.training.matrix import check_variants, compared_variants, refuse_links, run_matrix
from dynaforge.training.ray_runs import RayRuns
from dynaforge.training.run_archive import write_archives
from dynaforge.training.run_pool import RunPool
from dynaforge.training.run_process import LocalRuns
from dynaforge.training.run_spec import Evaluation, RunSpec


def run(options: argparse.Namespace) -> int:
    """Make the runs that are missing, then write the table and the report."""
    specs = matrix(options)
    if options.report_only and not any(spec.finished for spec in specs):
        raise ValueError(
            f"--report-only finds none of these runs finished in {options.out}; leave it out to start them."
        )
    for spec in specs:
        refuse_links(spec.folder, options.out)
        spec.check(definition=not options.report_only or bool(chosen_parts(options)))
    ray = not options.report_only and on_ray(options)
    if not options.report_only:
        print(*setting_lines((Path(spec.task).stem, str(spec.setting)) for spec in specs), sep="\n")
    make_folder(options.out)
    missing = [spec for spec in specs if not spec.finished]
    print(f"{len(specs)} runs, {len(specs) - len(missing)} finished; stored in {options.out}")
    complete = not missing
    if missing and not options.report_only:
        runs = RayRuns(missing, options.workers) if ray else LocalRuns(missing, options.workers or usable_cores())
        complete = RunPool(missing, runs, seconds=60 * (options.budget or float("inf"))).work()
    comparison = Comparison.load(options.out, [spec.folder for spec in specs if spec.finished])
    if not comparison.runs:
        print("nothing is finished yet, so there is nothing to report")
        return 1
    write_archives(spec.folder for spec in specs if spec.finished)
    date = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    page = write_comparison(options.out, comparison, command=options.command, date=date)
    print(f"\n{comparison_table(comparison)}\n")
    print(f"report {page}")
    if not complete and not options.report_only:
        print("not finished: the same command resumes where it stopped")
    return 0 if complete or options.report_only else 1


def matrix(options: argparse.Namespace) -> list[RunSpec]:
    """List the runs that the options ask for.

    Raises:
        ValueError: Something is unknown or out of range; this is raised before any run is started.
    """
    tasks = chosen_tasks(options)
    compared = compared_variants(options.algos, options.vary)
    try:
        check_variants(compared, tasks[0].name)
    except ValueError as error:
        raise ValueError(f"--vary: {error}" if options.vary else str(error)) from error
    return run_matrix(
        tasks,
        compared,
        seeds=options.train_seeds,
        steps=int(options.steps),
        evaluation=Evaluation(options.stream, options.seeds, options.attempts),
        out=options.out,
    )
