"""The report of `dynaforge forge`: rates, learning curves and films on one page."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

from dynaforge.demos import Attempt
from dynaforge.evaluation import DgrReport, PairedDifference
from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions
from dynaforge.reports.film import film_clips
from dynaforge.reports.html import ReportData, ReportFigure, write_report
from dynaforge.reports.plots import dgr_by_difficulty, failure_bars, learning_curve, stratum_heatmap
from dynaforge.tasks import Task
from dynaforge.training.forge_folder import REPORT
from dynaforge.training.history import TrainingHistory


def write_forge_report(
    folder: Path,
    task: Task,
    policy: Path,
    *,
    command: str,
    algo: str,
    seed: int,
    history: TrainingHistory,
    reports: list[DgrReport],
    paired: PairedDifference,
    attempts: list[Attempt],
) -> None:
    """Write result.json and report.html.

    Args:
        folder: Where they are written, the page last.
        task: The task.
        policy: File of the trained policy, for the films.
        command: The command that made the run.
        algo: Name of the file in zoo_configs that the policy was trained with.
        seed: Training seed.
        history: History of the training.
        reports: DGR of planner only, and of planner and residual.
        paired: Their difference, condition by condition.
        attempts: The attempts with the residual, some of which are filmed.
    """
    versions = package_versions()
    result = {
        "command": command,
        "task": task.name,
        "algo": algo,
        "seed": seed,
        "versions": versions,
        "updates": len(history),
        "reports": [report.to_dict() for report in reports],
        "paired": {"difference": paired.difference, "interval": list(paired.interval), "p": paired.p_value},
    }
    atomic_write(folder / "result.json", json.dumps(result, indent=2).encode())
    data = ReportData(
        title=f"{task.env_name}: demonstrations forged",
        task=task.name,
        command=command,
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        seeds={"training seed": seed, "conditions": "stream test, block 0"},
        versions=versions,
        reports=reports,
        paired=paired,
        figures=[*_training_figures(algo, history, reports), *_measured_figures(reports)],
        clips=film_clips(task, policy, attempts),
        attempts=attempts,
    )
    write_report(folder / REPORT, data)


def _training_figures(algo: str, history: TrainingHistory, reports: list[DgrReport]) -> list[ReportFigure]:
    if len(history) < 2:
        return []
    curve = learning_curve({algo: history.success}, planner_only=reports[0].mean, final=reports[1].mean)
    heatmap = stratum_heatmap(history.frontier())
    return [
        ReportFigure("Learning curve", "Success of rollouts; the line is the mean of the last 20 updates.", curve),
        ReportFigure("Success by stratum over updates", "Red: the competence frontier.", heatmap),
    ]


def _measured_figures(reports: list[DgrReport]) -> list[ReportFigure]:
    return [
        ReportFigure("Success by difficulty", "Wilson 95 % intervals.", dgr_by_difficulty(reports)),
        ReportFigure("Why attempts failed", "Failed attempts by reason.", failure_bars(reports)),
    ]
