"""A comparison of training runs as a table of text."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from statistics import mean, stdev

from rich.console import Console
from rich.table import Table

from dynaforge.training.comparison import FINAL_PROBES, Comparison, VariantSummary

COLUMNS = (
    "seeds",
    "DGR %",
    "std",
    "val %",
    "opt. steps",
    "against",
    "95 %",
    "95 % by t",
    "opt. ratio",
    "steps to",
    "probes",
    "used",
    "sim",
    "opt.",
    "wall sim",
    "wall opt.",
)


def comparison_table(comparison: Comparison) -> str:
    """Return a comparison as plain text: one row per variant and task, then the means over the tasks."""
    grid = Table()
    for name in ("task", "variant", *COLUMNS):
        grid.add_column(name, justify="left" if name in ("task", "variant") else "right")
    for task in comparison.tasks:
        if not math.isnan(comparison.planner(task)):
            grid.add_row(task, "planner only", "", f"{100 * comparison.planner(task):.1f}")
        for variant in comparison.variants:
            if comparison.of(task, variant):
                grid.add_row(task, variant, *cells(comparison, variant, [task]))
        grid.add_section()
    for variant in comparison.variants:
        shared = comparison.complete_tasks(variant)
        if len(shared) > 1:
            grid.add_row(f"mean of {len(shared)}", variant, *cells(comparison, variant, shared))
    console = Console(file=io.StringIO(), width=220, color_system=None, force_terminal=False)
    with console.capture() as capture:
        console.print(grid)
    rows = "\n".join(line.rstrip() for line in capture.get().rstrip().splitlines())
    return f"{rows}\n{legend(comparison)}"


def legend(comparison: Comparison) -> str:
    """Return in which setting the runs were made, which of them do not compare, and what the columns mean."""
    evaluation, reference, mixed = comparison.runs[0].evaluation, comparison.reference, comparison.mixed_tasks
    warning = f"Do not compare the runs of {', '.join(mixed)}: they are of several definitions of the task.\n"
    return (
        f"Made under {comparison.settings}.\n{warning if mixed else ''}"
        f"DGR of the final policy without exploration on {evaluation.blocks} x {evaluation.attempts} conditions of "
        f"{evaluation.stream}, mean and std over training seeds; mean of the last {FINAL_PROBES} probes\non val, "
        f"without exploration; optimizer steps of a run; against {reference} in points, 95 % bootstrap over training "
        "seeds and conditions,\nand 95 % by Student's t, which holds where few seeds disagree too ('-': one seed does "
        f"not tell); optimizer steps and environment steps to {reference}'s final success\nin training, and in "
        "probes, as ratios to it ('-': not reached); of a run: thousands of transitions in kept "
        "groups, minutes of simulation and of optimisation, CPU and wall, on one core."
    )


def cells(comparison: Comparison, variant: str, tasks: Sequence[str]) -> list[str]:
    """Return the figures of a variant as text, means over tasks, in the order of `COLUMNS`.

    Args:
        comparison: The runs.
        variant: Name of the variant.
        tasks: Names of tasks on which it finished a run.
    """
    summaries = [comparison.summary(task, variant) for task in tasks]
    return [*_rates(summaries), *_against_reference(comparison, variant, tasks), *_costs(summaries)]


def _rates(summaries: Sequence[VariantSummary]) -> list[str]:
    seeds = min(len(s.rates) for s in summaries)
    rate = mean(mean(s.rates) for s in summaries)
    by_seed = [mean(s.rates[k] for s in summaries) for k in range(seeds)]
    final_probes = mean(s.final_probes for s in summaries)
    return [
        str(seeds),
        f"{100 * rate:.1f}",
        f"{100 * stdev(by_seed):.1f}" if seeds > 1 else "-",
        "-" if math.isnan(final_probes) else f"{100 * final_probes:.1f}",
        f"{mean(s.optimizer_steps for s in summaries):.0f}",
    ]


def _against_reference(comparison: Comparison, variant: str, tasks: Sequence[str]) -> list[str]:
    reference = comparison.reference
    if variant == reference or not all(comparison.of(task, reference) for task in tasks):
        return ["-"] * 6
    found = comparison.difference(variant, tasks)
    intervals = (found.interval, comparison.few_seeds_interval(variant, tasks))
    pairs = [(comparison.summary(task, variant), comparison.summary(task, reference)) for task in tasks]
    ratios = (
        mean(getattr(ours, name) / getattr(theirs, name) for ours, theirs in pairs)
        for name in ("optimizer_steps", "steps_to_vanilla", "probe_steps_to_vanilla")
    )
    return [
        f"{100 * found.difference:+.1f}",
        *(f"{100 * low:+.1f} to {100 * high:+.1f}" if math.isfinite(low) else "-" for low, high in intervals),
        *(f"{ratio:.2f} x" if math.isfinite(ratio) else "-" for ratio in ratios),
    ]


def _costs(summaries: Sequence[VariantSummary]) -> list[str]:
    return [
        f"{mean(s.transitions_used for s in summaries) / 1000:.1f}",
        f"{mean(s.collect_cpu for s in summaries) / 60:.1f}",
        f"{mean(s.optimize_cpu for s in summaries) / 60:.2f}",
        f"{mean(s.collect_wall for s in summaries) / 60:.1f}",
        f"{mean(s.optimize_wall for s in summaries) / 60:.2f}",
    ]
