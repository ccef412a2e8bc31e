"""`dynaforge evaluate`: the demonstration generation rate of generators on the same stored conditions."""

from __future__ import annotations

import argparse
import json
import time
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.demos import Attempt
from dynaforge.evaluation import DgrReport, comparison_table, paired_difference, task_table
from dynaforge.evaluation.dgr import describe_gain
from dynaforge.evaluation.statistics import no_bin_lost
from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions
from dynaforge.generators import Generator
from dynaforge.generators.by_name import make_generator
from dynaforge.generators.measure import measure
from dynaforge.tasks import Task

BINS = 8


def run(options: argparse.Namespace) -> int:
    """Measure, print and store.

    Raises:
        GaveUp: A generator only raises, so that there is nothing to measure.
    """
    tasks = chosen_tasks(options)
    generators_of_task = [[generator_of(name, task, options) for name in options.generator] for task in tasks]
    out = options.out
    table: dict[str, list[DgrReport]] = {}
    started = time.monotonic()
    for task, generators in zip(tasks, generators_of_task, strict=True):
        measured = {g.name: _measured(task, g, options) for g in generators}
        reports = [_report(task, name, attempts) for name, attempts in measured.items()]
        print(f"\n{task.name}: stream {options.stream}, {options.seeds} x {options.attempts} conditions")
        print(comparison_table(reports))
        gains = _gains(task, measured)
        for line in gains["text"]:
            print(line)
        for report in reports:
            print(report.table())
        path = out if len(tasks) == 1 else out.with_stem(f"{out.stem}-{task.name}")
        _write(path, options.command, task, reports, gains, measured)
        print(f"written to {path}")
        table[task.name] = reports
    if len(tasks) > 1:
        minutes = (time.monotonic() - started) / 60
        print(f"\n{task_table(table)}\ntook {minutes:.1f} minutes")
        tasks_json = {n: [r.to_dict() for r in rs] for n, rs in table.items()}
        _write_json(out, options.command, {"minutes": round(minutes, 1), "tasks": tasks_json})
        print(f"written to {out}")
    return 0


def generator_of(name: str, task: Task, options: argparse.Namespace) -> Generator:
    """Make a generator as the options ask for it.

    Raises:
        ValueError: A residual without a policy file, given or shipped, or with one that does not fit.
    """
    asked = {
        key: value
        for key in ("policy", "sigma", "oracle_tries", "learner", "observations")
        if (value := getattr(options, key, None)) is not None
    }
    try:
        return make_generator(name, task, **asked)
    except ValueError as error:
        raise ValueError(f"--policy: {error}" if "policy" in asked else str(error)) from error


def _measured(task: Task, generator: Generator, options: argparse.Namespace) -> list[Attempt]:
    n_strata = BINS if options.strata else None
    blocks = (
        islice(task.conditions.stream(options.stream, block, n_strata=n_strata), options.attempts)
        for block in range(options.seeds)
    )
    return measure(task, generator, blocks, total=options.seeds * options.attempts, workers=options.workers)


def _report(task: Task, name: str, attempts: list[Attempt]) -> DgrReport:
    return DgrReport.from_attempts(attempts, difficulty_range=task.conditions.difficulty_range, n_bins=BINS, label=name)


def _gains(task: Task, measured: dict[str, list[Attempt]]) -> dict[str, Any]:
    """Compare every generator with the first one, condition by condition."""
    (first, before), *others = measured.items()
    result: dict[str, Any] = {"text": []}
    for name, after in others:
        paired = paired_difference([a.success for a in before], [a.success for a in after])
        result["text"].append(f"{name} against {first}: {describe_gain(paired)}")
        result[name] = {
            "against": first, "difference": paired.difference, "interval": list(paired.interval), "p": paired.p_value,
        }  # fmt: skip
        bins = [[a.success for a in run] for run in (before, after)]
        if len(before) % BINS == 0 and _evenly_spread(task, before):
            by_bin = [[run[k::BINS] for k in range(BINS)] for run in bins]
            verdict = no_bin_lost(*by_bin)
            result[name]["no_bin_lost"] = {"holds": verdict.holds, "lost": list(verdict.lost)}
            result["text"].append(f"no bin lost: {'holds' if verdict.holds else f'lost {verdict.lost}'}")
    return result


def _evenly_spread(task: Task, attempts: list[Attempt]) -> bool:
    """Tell whether attempt i lies in bin i modulo BINS, as `--strata` draws them."""
    return all(task.conditions.stratum(a.difficulty, BINS) == i % BINS for i, a in enumerate(attempts))


def _write(
    path: Path, command: str, task: Task, reports: list[DgrReport], gains: dict[str, Any],
    measured: dict[str, list[Attempt]],
) -> None:  # fmt: skip
    data = {
        "task": task.name,
        "reports": [report.to_dict() for report in reports],
        "gains": {name: value for name, value in gains.items() if name != "text"},
        "conditions": [
            {"id": a.condition.id, "block": a.block, "difficulty": round(a.difficulty, 4)}
            for a in next(iter(measured.values()))
        ],
        "outcomes": {name: [str(a.outcome) for a in attempts] for name, attempts in measured.items()},
    }
    _write_json(path, command, data)


def _write_json(path: Path, command: str, data: dict[str, Any]) -> None:
    about = {
        "command": command,
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "versions": package_versions(),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, json.dumps(about | data, indent=1).encode() + b"\n")
