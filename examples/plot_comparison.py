"""Draw the figures of a task from the stored runs of a comparison, as PNG files for a paper or a page.

python examples/plot_comparison.py results/compare --task toycar --variants grpo frontier_grpo --out runs/figures
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dynaforge.files.atomic import atomic_write
from dynaforge.reports import task_figures
from dynaforge.training.comparison import Comparison


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what `dynaforge compare --out` names")
    parser.add_argument("--task", default="can")
    parser.add_argument("--variants", "--arms", nargs="+", default=["grpo", "frontier_grpo"])
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    place = options.folder / options.task
    exams = [
        place / "planner_only/exam.json",
        *(e for variant in options.variants for e in sorted(place.glob(f"{variant}/*/exam.json"))),
    ]
    comparison = Comparison.load(options.folder, [exam.parent for exam in exams if exam.is_file()])
    if not comparison.variants:
        parser.error(f"{place} holds no finished run of {', '.join(options.variants)}.")
    options.out.mkdir(parents=True, exist_ok=True)
    for figure in task_figures(comparison, options.task, comparison.variants, fmt="png"):
        name = figure.title.lower().replace(",", "").replace(" ", "-")
        atomic_write(options.out / f"{options.task}-{name}.png", figure.image)
        print(options.out / f"{options.task}-{name}.png")


if __name__ == "__main__":
    main()
