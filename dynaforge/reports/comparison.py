"""The report of `dynaforge compare`: one table and one self-contained page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import mean

from dynaforge.files.atomic import atomic_write
from dynaforge.reports.html import ReportFigure, render
from dynaforge.reports.plots import Format, learning_curve, probe_curve, stratum_heatmap
from dynaforge.reports.template import COMPARISON
from dynaforge.training.comparison import COLUMNS, Comparison


def write_comparison(folder: Path, comparison: Comparison, *, command: str, date: str) -> Path:
    """Write `table.txt` and `report.html` into a folder; returns the page.

    Raises:
        ImportError: Matplotlib or Jinja2, of the `[report]` extra, is missing.
        OSError: The folder is not writable, or the disk is full.
    """
    atomic_write(folder / "table.txt", f"{command}\n\n{comparison.table()}\n".encode())
    page = folder / "report.html"
    text = render(
        COMPARISON,
        title=f"{', '.join(comparison.arms)} on {', '.join(comparison.tasks)}",
        command=command,
        date=date,
        columns=COLUMNS,
        sections=list(_sections(comparison)),
        legend=comparison.legend(),
        settings={run.arm: run.settings for run in comparison.runs if run.settings},
    )
    atomic_write(page, text.encode())
    return page


def _sections(comparison: Comparison) -> Iterator[dict[str, object]]:
    """Give title, rows and figures of the means and of each task."""
    shared = {arm: comparison.complete_tasks(arm) for arm in comparison.arms}
    if any(len(tasks) > 1 for tasks in shared.values()):
        rows = [(f"{arm} (mean of {len(t)})", comparison.cells(arm, t)) for arm, t in shared.items() if t]
        yield {"title": "All tasks", "rows": rows, "groups": [], "figures": []}
    for task in comparison.tasks:
        arms = [arm for arm in comparison.arms if comparison.of(task, arm)]
        rows = [(arm, comparison.cells(arm, [task])) for arm in arms]
        if not math.isnan(comparison.planner(task)):
            rows.insert(0, ("planner only", ["", f"{100 * comparison.planner(task):.1f}"]))
        summaries = {arm: comparison.summary(task, arm) for arm in arms}
        groups = [
            (arm, *(f"{100 * share:.0f} %" for share in s.groups), f"{100 * s.lost_again:.0f} %")
            for arm, s in summaries.items()
            if s.groups
        ]
        yield {"title": task, "rows": rows, "groups": groups, "figures": list(task_figures(comparison, task, arms))}


def task_figures(
    comparison: Comparison, task: str, arms: Sequence[str], *, fmt: Format = "svg"
) -> Iterator[ReportFigure]:
    """Draw what a comparison says about a task: learning curves, the frontier of each arm, success unexplored."""
    planner = comparison.planner(task)
    if not arms:
        return
    yield ReportFigure(
        "Success in training",
        "Exploring episodes, mean over training seeds; lines are means of the last 20 updates, faint traces single "
        "updates. Horizontal: the planner alone, dashed; final policies without exploration, dash-dotted.",
        learning_curve(
            {arm: comparison.curve(task, arm) for arm in arms},
            steps={arm: comparison.steps(task, arm) for arm in arms},
            planner_only=None if math.isnan(planner) else planner,
            final={arm: mean(comparison.summary(task, arm).rates) for arm in arms},
            fmt=fmt,
        ),
    )
    for arm in reversed(arms):  # what the comparison is about comes last on the command line
        yield ReportFigure(
            f"Success by stratum, {arm}",
            "Outcomes of all training seeds pooled. Red: the competence frontier, the deepest rank up to which the "
            "Wilson lower bound of every stratum is at least one half.",
            stratum_heatmap(comparison.frontier(task, arm), fmt=fmt),
        )
    probes = {arm: comparison.probes(task, arm) for arm in arms}
    yield ReportFigure(
        "Success without exploration",
        "One val condition of each of 16 strata at every measurement, mean over training seeds.",
        probe_curve({arm: p[1] for arm, p in probes.items()}, {arm: p[0] for arm, p in probes.items()}, fmt=fmt),
    )
