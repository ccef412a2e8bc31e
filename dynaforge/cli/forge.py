"""`dynaforge forge`: from nothing to demonstrations."""

from __future__ import annotations

import argparse
import contextlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli.arguments.tasks import chosen_task
from dynaforge.cli.tally import Tally
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.evaluation import DgrReport, PairedDifference, comparison_table, paired_difference
from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions
from dynaforge.generators import GaveUp, Generator, Goal, PlannerOnly, ResidualGenerator, collect, run_attempts
from dynaforge.generators.giving_up import describe_counts, unless_all_raise
from dynaforge.reports import (
    ReportData,
    ReportFigure,
    dgr_by_difficulty,
    failure_bars,
    learning_curve,
    stratum_heatmap,
    write_report,
)
from dynaforge.reports.film import film_clips
from dynaforge.sim import Condition
from dynaforge.tasks import Task
from dynaforge.tasks.digest import task_digest
from dynaforge.training import model as training
from dynaforge.training.checkpoint import load_checkpoint, save_checkpoint
from dynaforge.training.forge_folder import ForgeFolder, asked_for
from dynaforge.training.history import TrainingHistory
from dynaforge.training.model import TimeLimit, TrainingMonitor

CHECKPOINT = "checkpoint.safetensors"
MEASURING_SHARE = 0.15  # of the budget: measuring twice, collecting, report


def run(options: argparse.Namespace) -> int:
    """Forge demonstrations, or go on with what an interruption left; see the module's description."""
    started = time.monotonic()
    task = chosen_task(options)
    if options.residual_frame is not None:
        task = replace(task, residual=replace(task.residual, frame=options.residual_frame))
    folder = ForgeFolder.of(options.out, _about(task, options))
    out = folder.path
    if folder.resumed:
        print(f"{out} holds this run{': finished' if folder.finished else ' in part: going on'}")

    print(f"[1/5] the planner alone, {options.attempts} fresh conditions")
    before = folder.stage("planner", lambda: _measured(task, [PlannerOnly()], "val", options))
    wins = [attempt.success for attempt in _attempts(before)[0]]
    print(f"      it wins {np.mean(wins):.0%}")

    seconds = 60 * options.budget * (1 - MEASURING_SHARE) - before["seconds"]
    print(f"[2/5] training with {options.algo}, {seconds / 60:.1f} minutes at most (Ctrl-C keeps what it has)")
    trained = train(task, options, folder, seconds)
    if trained.interrupted:
        print(f"interrupted after {len(trained.history)} updates; policy saved: {out / 'policy.safetensors'}")
        print("the same command goes on")
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
        _write(out, task, options, trained.history, reports, paired, pair[1])
    print()
    print(comparison_table(reports, paired=paired))
    print(f"demos   {dataset.path}  ({len(dataset)} episodes, {dataset.dgr():.0%} of attempts succeeded)")
    print(f"policy  {out / 'policy.safetensors'}")
    print(f"report  {out / 'report.html'}")
    print(f"took {(time.monotonic() - started) / 60:.1f} minutes")
    return 0 if len(dataset) >= options.demos else 1


@dataclass(frozen=True, slots=True)
class Trained:
    """What `train` returns."""

    policy: MlpPolicyFile
    history: TrainingHistory
    interrupted: bool


def train(task: Task, options: argparse.Namespace, folder: ForgeFolder, seconds: float) -> Trained:
    """Train until the time or the updates are up; every update is stored, and a resumed training goes on from there."""
    stored, checkpoint, policy = (folder.path / name for name in ("history.json", CHECKPOINT, "policy.safetensors"))
    if (folder.path / "trained.json").is_file():
        return Trained(MlpPolicyFile.load(policy, task=task), TrainingHistory.load(stored), interrupted=False)
    settings = training.hyperparameters(options.algo, task.name)
    env = training.training_env(task, settings["n_envs"], algo=options.algo, cores=options.workers)
    history, interrupted, total = TrainingHistory(), False, int(settings["n_timesteps"])

    def save() -> MlpPolicyFile:
        saved = training.policy_file(model, task.name, algo=options.algo, seed=options.seed, updates=len(history))
        history.save(stored)  # first: a history longer than its checkpoint is cut, a shorter one would have a hole
        save_checkpoint(model, checkpoint)
        saved.save(policy)
        return saved

    def between_updates(updates: int) -> bool:
        if updates:
            save()
        return limit(updates)

    try:
        counting = {} if options.algo == "ppo" else {"timesteps": "gated"}
        model = training.build_model(task.name, env, algo=options.algo, seed=options.seed, **counting)
        if checkpoint.is_file():
            load_checkpoint(model, checkpoint, seed=options.seed)
            history = TrainingHistory.load(stored).up_to(model.num_timesteps)
            print(f"      going on after {len(history)} updates")
        resumed = len(history) > 0
        limit = TimeLimit(history, seconds=seconds, updates=options.updates)
        try:
            monitor = TrainingMonitor(history, task.conditions, between_updates)
            left = total - model.num_timesteps
            with training.decaying_within(model, limit.used):
                if left > 0:
                    model.learn(left, callback=monitor, reset_num_timesteps=not resumed)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            limit.close()
        final = save()
        training.save_model(model, folder.path / "model.zip")
    finally:
        env.close()
    if not interrupted:
        folder.stage("trained", lambda: {"updates": len(history), "policy": final.digest})
    return Trained(final, history, interrupted)


def _about(task: Task, options: argparse.Namespace) -> dict[str, Any]:
    """Return what makes it this run; how many workers make it may change."""
    settings = training.hyperparameters(options.algo, task.name)
    return asked_for(options) | {"task_definition": task_digest(task), "settings": settings}


def _measured(task: Task, generators: Sequence[Generator], stream: str, options: argparse.Namespace) -> dict[str, Any]:
    """Measure generators on the same conditions; returns plain data."""
    started = time.monotonic()
    conditions = list(islice(task.conditions.stream(stream), options.attempts))
    runs = [_measure(task, generator, conditions, options.workers) for generator in generators]
    return {
        "attempts": [[attempt.to_dict() for attempt in attempts] for attempts in runs],
        "seconds": time.monotonic() - started,
    }


def _attempts(measured: dict[str, Any]) -> list[list[Attempt]]:
    return [[Attempt.from_dict(data) for data in attempts] for attempts in measured["attempts"]]


def _measure(task: Task, generator: Generator, conditions: Sequence[Condition], workers: int) -> list[Attempt]:
    results = unless_all_raise(run_attempts(task, generator, conditions, workers=workers), generator=generator.name)
    return [r.attempt for r in tqdm(results, total=len(conditions), leave=False, unit="attempt", desc=generator.name)]


def _report(task: Task, attempts: list[Attempt]) -> DgrReport:
    label = {"planner_only": "planner only", "residual": "with residual"}[attempts[0].generator]
    return DgrReport.from_attempts(attempts, difficulty_range=task.conditions.difficulty_range, label=label)


def _collect(task: Task, generator: Generator, folder: Path, options: argparse.Namespace) -> DemonstrationDataset:
    dataset = DemonstrationDataset(folder, task=task.name)
    goal = Goal(options.demos, 20 * options.demos)
    with Tally(goal, leave=False) as tally, contextlib.suppress(GaveUp):
        collect(dataset, task, generator, goal, workers=options.workers, tell=tally.add)
    if tally.wins < options.demos:
        print(f"      only {tally}: {describe_counts(tally.reasons)}. Train longer (--budget)")
    return dataset


def _write(
    out: Path, task: Task, options: argparse.Namespace, history: TrainingHistory, reports: list[DgrReport],
    paired: PairedDifference, attempts: list[Attempt],
) -> None:  # fmt: skip
    result = {
        "command": options.command,
        "task": task.name,
        "algo": options.algo,
        "seed": options.seed,
        "versions": package_versions(),
        "updates": len(history),
        "reports": [report.to_dict() for report in reports],
        "paired": {"difference": paired.difference, "interval": list(paired.interval), "p": paired.p_value},
    }
    atomic_write(out / "result.json", json.dumps(result, indent=2).encode())
    figures = [ReportFigure("Success by difficulty", "Wilson 95 % intervals.", dgr_by_difficulty(reports))]
    figures.append(ReportFigure("Why attempts failed", "Attempts lost to each reason.", failure_bars(reports)))
    if len(history) > 1:
        curve = learning_curve({options.algo: history.success}, planner_only=reports[0].mean, final=reports[1].mean)
        heatmap = stratum_heatmap(history.frontier())
        figures = [
            ReportFigure("Learning curve", "Success of exploring rollouts; trailing 20-update mean.", curve),
            ReportFigure("Success by stratum over updates", "Red: the competence frontier.", heatmap),
            *figures,
        ]
    write_report(
        out / "report.html",
        ReportData(
            title=f"{task.env_name}: demonstrations forged",
            task=task.name,
            command=options.command,
            date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            seeds={"training seed": options.seed, "conditions": "stream test, block 0"},
            versions=package_versions(),
            reports=reports,
            paired=paired,
            figures=figures,
            clips=film_clips(task, out / "policy.safetensors", attempts),
            attempts=attempts,
        ),
    )
