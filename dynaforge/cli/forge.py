"""`dynaforge forge`: from nothing to demonstrations."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from dynaforge.algos.policy_file import POLICY_FILE
from dynaforge.cli.arguments.tasks import chosen_task
from dynaforge.cli.tally import Tally
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.evaluation import DgrReport, comparison_table, paired_difference
from dynaforge.generators import GaveUp, Generator, Goal, PlannerOnly, ResidualGenerator, collect
from dynaforge.generators.giving_up import describe_counts
from dynaforge.generators.measure import measure
from dynaforge.reports.forge import write_forge_report
from dynaforge.tasks import Stream, Task
from dynaforge.tasks.digest import task_digest
from dynaforge.training.forge import train
from dynaforge.training.forge_folder import REPORT, ForgeFolder, asked_for
from dynaforge.training.settings import hyperparameters

MEASURING_SHARE = 0.15  # of the budget: measuring twice, collecting, report
LABELS = {"planner_only": "planner only", "residual": "with residual"}


def run(options: argparse.Namespace) -> int:
    """Forge demonstrations, or resume an interrupted run of this command."""
    started = time.monotonic()
    task = chosen_task(options)
    if options.residual_frame is not None:
        task = replace(task, residual=replace(task.residual, frame=options.residual_frame))
    folder = ForgeFolder.of(options.out, _identity(task, options))
    out = folder.path
    if folder.resumed:
        print(f"{out} holds this run{': finished' if folder.finished else ' in part: resuming'}")

    print(f"{task.name}: {task.setting}")
    print(f"[1/5] the planner only, {options.attempts} fresh conditions")
    before = folder.stage("planner", lambda: _measured(task, [PlannerOnly()], "val", options))
    print(f"      success {np.mean([attempt.success for attempt in _attempts(before)[0]]):.0%}")

    seconds = 60 * options.budget * (1 - MEASURING_SHARE) - before["seconds"]
    print(f"[2/5] training with {options.algo}, {seconds / 60:.1f} minutes at most (Ctrl-C keeps what it has)")
    trained = train(
        task,
        folder,
        algo=options.algo,
        seed=options.seed,
        seconds=seconds,
        updates=options.updates,
        workers=options.workers,
    )
    if trained.interrupted:
        print(f"interrupted after {len(trained.history)} updates; policy saved: {out / POLICY_FILE}")
        print("the same command resumes")
        return 130

    print(f"[3/5] planner and residual on {options.attempts} other fresh conditions")
    residual = ResidualGenerator(trained.policy, policy_hash=trained.policy.digest)
    pair = _attempts(folder.stage("measured", lambda: _measured(task, [PlannerOnly(), residual], "test", options)))
    paired = paired_difference(*[[a.success for a in attempts] for attempts in pair])
    reports = [_report(task, attempts) for attempts in pair]

    print(f"[4/5] collecting {options.demos} demonstrations")
    dataset = _collect(task, residual, out / "demos", options)

    if not folder.finished:
        print("[5/5] writing the report")
        write_forge_report(
            out,
            task,
            out / POLICY_FILE,
            command=options.command,
            algo=options.algo,
            seed=options.seed,
            history=trained.history,
            reports=reports,
            paired=paired,
            attempts=pair[1],
        )
    print(f"\n{comparison_table(reports, paired=paired)}")
    _print_results(out, dataset)
    print(f"took {(time.monotonic() - started) / 60:.1f} minutes")
    return 0 if len(dataset) >= options.demos else 1


def _identity(task: Task, options: argparse.Namespace) -> dict[str, Any]:
    """Return what identifies this run; the number of workers does not."""
    settings = hyperparameters(options.algo, task.name)
    return asked_for(options) | {"task_definition": task_digest(task), "settings": settings}


def _measured(
    task: Task, generators: Sequence[Generator], stream: Stream, options: argparse.Namespace
) -> dict[str, Any]:
    """Measure generators on the same conditions, and return plain JSON data."""
    started = time.monotonic()
    total, workers = options.attempts, options.workers
    conditions = list(islice(task.conditions.stream(stream), total))
    runs = [measure(task, generator, [conditions], total=total, workers=workers) for generator in generators]
    return {
        "attempts": [[attempt.to_dict() for attempt in attempts] for attempts in runs],
        "seconds": time.monotonic() - started,
    }


def _attempts(measured: dict[str, Any]) -> list[list[Attempt]]:
    return [[Attempt.from_dict(data) for data in attempts] for attempts in measured["attempts"]]


def _print_results(out: Path, dataset: DemonstrationDataset) -> None:
    print(f"demos   {dataset.path}  ({len(dataset)} episodes, {dataset.dgr():.0%} of attempts succeeded)")
    print(f"policy  {out / POLICY_FILE}")
    print(f"report  {out / REPORT}")


def _report(task: Task, attempts: list[Attempt]) -> DgrReport:
    label = LABELS[attempts[0].generator]
    return DgrReport.from_attempts(attempts, difficulty_range=task.conditions.difficulty_range, label=label)


def _collect(task: Task, generator: Generator, folder: Path, options: argparse.Namespace) -> DemonstrationDataset:
    dataset = DemonstrationDataset(folder, task=task.name)
    goal = Goal(options.demos, 20 * options.demos)
    with Tally(goal, leave=False) as tally, contextlib.suppress(GaveUp):
        collect(dataset, task, generator, goal, workers=options.workers, on_attempt=tally.add)
    if tally.successes < options.demos:
        print(f"      only {tally}: {describe_counts(tally.reasons)}. Train longer (--budget)")
    return dataset
