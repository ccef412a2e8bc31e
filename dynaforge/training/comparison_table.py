"""A comparison of training runs as a table of text."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from statistics import mean, stdev

from rich.console import Console
from rich.table import Table

from dynaforge.training.comparison import FINAL_PROBES, Comparison

COLUMNS = (
    "seeds", "DGR %", "std", "val %", "opt. steps", "against", "95 %", "opt. ratio", "steps to", "greedy", "used",
    "sim", "opt.", "wall sim", "wall opt.",
)  # fmt: skip


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
    console = Console(file=io.StringIO(), width=200, color_system=None, force_terminal=False)
    with console.capture() as capture:
        console.print(grid)
    rows = "\n".join(line.rstrip() for line in capture.get().rstrip().splitlines())
    return f"{rows}\n{legend(comparison)}"


def legend(comparison: Comparison) -> str:
    """Say what the columns of the table mean."""
    evaluation, reference = comparison.runs[0].evaluation, comparison.reference
    return (
        f"DGR of the final policy without exploration on {evaluation.blocks} x {evaluation.attempts} conditions of "
        f"{evaluation.stream}, mean and std over training seeds; mean of the last {FINAL_PROBES} probes\non val, "
        f"without exploration; optimizer steps of a run; against {reference} in points, 95 % bootstrap over training "
        f"seeds and conditions;\noptimizer steps and environment steps to {reference}'s final success in "
        "training, and in probes, as ratios to it ('-': not reached);\nof a run: thousands of transitions in kept "
        "groups, minutes of simulation and of optimisation, CPU and wall, on one core."
    )


def cells(comparison: Comparison, variant: str, tasks: Sequence[str]) -> list[str]:
    """Return the figures of a variant over tasks as text, in the order of `COLUMNS`."""
    mine = [comparison.summary(task, variant) for task in tasks]
    seeds = min(len(s.rates) for s in mine)
    rate = mean(mean(s.rates) for s in mine)
    over_seeds = [mean(s.rates[k] for s in mine) for k in range(seeds)]
    cells = [str(seeds), f"{100 * rate:.1f}", f"{100 * stdev(over_seeds):.1f}" if seeds > 1 else "-"]
    late = mean(s.late for s in mine)
    cells += ["-" if math.isnan(late) else f"{100 * late:.1f}", f"{mean(s.optimizer_steps for s in mine):.0f}"]
    if variant == comparison.reference or not all(comparison.of(task, comparison.reference) for task in tasks):
        compared = ["-"] * 5
    else:
        theirs = [comparison.summary(task, comparison.reference) for task in tasks]
        found = comparison.difference(variant, tasks)
        low, high = found.interval
        ratios = (
            mean(getattr(a, name) / getattr(b, name) for a, b in zip(mine, theirs, strict=True))
            for name in ("optimizer_steps", "steps_to_vanilla", "greedy_steps_to_vanilla")
        )
        compared = [
            f"{100 * found.difference:+.1f}", f"{100 * low:+.1f} to {100 * high:+.1f}",
            *(f"{ratio:.2f} x" if math.isfinite(ratio) else "-" for ratio in ratios),
        ]  # fmt: skip
    costs = [f"{mean(s.transitions_used for s in mine) / 1000:.1f}"]
    for name in ("collect_cpu", "optimize_cpu", "collect_wall", "optimize_wall"):
        minutes = mean(getattr(s, name) for s in mine) / 60
        costs.append(f"{minutes:.2f}" if name.startswith("optimize") else f"{minutes:.1f}")
    return [*cells, *compared, *costs]
