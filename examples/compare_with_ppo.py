"""Compare FrontierGRPO with PPO at equal environment steps, and draw the figures as PNG files.

python examples/compare_with_ppo.py --task can                    # six runs, one per core; the same command resumes
python examples/compare_with_ppo.py --task toycar --algos ppo grpo frontier_grpo --runs results/compare --report-only
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from dynaforge.cli.main import main as dynaforge
from dynaforge.reports import task_figures
from dynaforge.training.comparison import Comparison
from dynaforge.training.run_archive import ARCHIVE, read_archive


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="can", help="one of the nine tasks")
    parser.add_argument("--algos", nargs="+", default=["ppo", "frontier_grpo"])
    parser.add_argument("--seeds", type=int, default=3, help="training seeds")
    parser.add_argument("--steps", default="1e5", help="environment steps of each run")
    parser.add_argument("--runs", type=Path, default=Path("runs/compare"), help="folder of the runs, table and report")
    parser.add_argument("--figures", type=Path, default=Path("runs/figures"))
    parser.add_argument("--report-only", action="store_true", help="train nothing, show what is stored")
    options = parser.parse_args()

    command = ["compare", "--task", options.task, "--algos", *options.algos, "--out", str(options.runs)]
    command += ["--train-seeds", str(options.seeds), "--steps", options.steps]
    status = dynaforge([*command, "--report-only"] if options.report_only else command)
    if status:
        return status

    # The same numbers in Python: every run with its training history and its outcome on every condition.
    stored = read_archive(options.runs / options.task / ARCHIVE)
    chosen = [name for name in stored if name.split("/")[0] in ("planner_only", *options.algos)]
    comparison = Comparison.load(options.runs, [options.runs / options.task / name for name in chosen])
    for variant in comparison.variants:
        rates = [f"{run.rate:.1%}" for run in comparison.of(options.task, variant)]
        print(f"{variant}: {', '.join(rates)} of the test conditions, by training seed")
    options.figures.mkdir(parents=True, exist_ok=True)
    for figure in task_figures(comparison, options.task, comparison.variants, fmt="png"):
        path = options.figures / f"{options.task}-{figure.title.lower().replace(', ', '-').replace(' ', '-')}.png"
        path.write_bytes(figure.image)
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
