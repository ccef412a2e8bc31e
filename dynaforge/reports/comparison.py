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
from dynaforge.training.comparison import Comparison
from dynaforge.training.comparison_table import COLUMNS, cells, comparison_table, legend


def write_comparison(folder: Path, comparison: Comparison, *, command: str, date: str) -> Path:
    """Write `table.txt` and `report.html` into a folder.

    Args:
        folder: The folder.
        comparison: The runs.
        command: The command that made them.
        date: The date to print.

    Returns:
        Path of the page.

    Raises:
        ImportError: Matplotlib or Jinja2, of the `[report]` extra, is missing.
        OSError: The folder is not writable, or the disk is full.
    """
    atomic_write(folder / "table.txt", f"{command}\n\n{comparison_table(comparison)}\n".encode())
    page = folder / "report.html"
    html = render(
        COMPARISON,
        title=f"{', '.join(comparison.variants)} on {', '.join(comparison.tasks)}",
        command=command,
        date=date,
        columns=COLUMNS,
        sections=list(_sections(comparison)),
        legend=legend(comparison),
        settings={run.variant: run.settings for run in comparison.runs if run.settings},
    )
    atomic_write(page, html.encode())
    return page


def _sections(comparison: Comparison) -> Iterator[dict[str, object]]:
    """Yield title, rows and figures of the section of the means, if any, and of each task."""
    shared = {variant: comparison.complete_tasks(variant) for variant in comparison.variants}
    if any(len(tasks) > 1 for tasks in shared.values()):
        rows = [
            (f"{variant} (mean of {len(tasks)})", cells(comparison, variant, tasks))
            for variant, tasks in shared.items()
            if tasks
        ]
        yield {"title": "All tasks", "rows": rows, "groups": [], "figures": []}
    for task in comparison.tasks:
        variants = [variant for variant in comparison.variants if comparison.of(task, variant)]
        rows = [(variant, cells(comparison, variant, [task])) for variant in variants]
        if not math.isnan(comparison.planner(task)):
            rows.insert(0, ("planner only", ["", f"{100 * comparison.planner(task):.1f}"]))
        summaries = {variant: comparison.summary(task, variant) for variant in variants}
        groups = [
            (variant, *(f"{100 * share:.0f} %" for share in s.groups), f"{100 * s.forgotten:.0f} %")
            for variant, s in summaries.items()
            if s.groups
        ]
        yield {"title": task, "rows": rows, "groups": groups, "figures": list(task_figures(comparison, task, variants))}


def task_figures(
    comparison: Comparison, task: str, variants: Sequence[str], *, fmt: Format = "svg"
) -> Iterator[ReportFigure]:
    """Draw a comparison on one task: learning curves, the frontier of each variant, success without exploration.

    Args:
        comparison: The runs.
        task: Name of the task.
        variants: Names of the variants to draw.
        fmt: Format of the images.
    """
    planner = comparison.planner(task)
    if not variants:
        return
    yield ReportFigure(
        "Success in training",
        "Rollouts, mean over training seeds; lines are means of the last 20 updates, faint traces single "
        "updates. Horizontal: planner only, dashed; final policies without exploration, dash-dotted.",
        learning_curve(
            {variant: comparison.curve(task, variant) for variant in variants},
            steps={variant: comparison.steps(task, variant) for variant in variants},
            planner_only=None if math.isnan(planner) else planner,
            final={variant: mean(comparison.summary(task, variant).rates) for variant in variants},
            fmt=fmt,
        ),
    )
    for variant in reversed(variants):  # what the comparison is about comes last on the command line
        yield ReportFigure(
            f"Success by stratum, {variant}",
            "Outcomes of all training seeds pooled. Red: the competence frontier, the deepest rank up to which the "
            "Wilson lower bound of every stratum is at least one half.",
            stratum_heatmap(comparison.frontier(task, variant), fmt=fmt),
        )
    probes = {variant: comparison.probes(task, variant) for variant in variants}
    yield ReportFigure(
        "Success without exploration",
        "One val condition of each of 16 strata at every probe, mean over training seeds.",
        probe_curve(
            {variant: success for variant, (_, success) in probes.items()},
            {variant: steps for variant, (steps, _) in probes.items()},
            fmt=fmt,
        ),
    )
