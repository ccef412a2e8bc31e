"""Draw the learning curves of stored runs, and the frontier of the first one.

python examples/plot_training.py results/compare/can/frontier_grpo/seed-0 --out runs
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dynaforge.demos import atomic_write
from dynaforge.evaluation import TrainingHistory
from dynaforge.reports import learning_curve, stratum_heatmap


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", help="folders with a history.json of `forge` or `compare`")
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    histories = {str(run): TrainingHistory.load(run / "history.json") for run in options.runs}
    options.out.mkdir(parents=True, exist_ok=True)
    curves = {name: history.success for name, history in histories.items()}
    atomic_write(options.out / "learning.png", learning_curve(curves, fmt="png"))
    first = next(iter(histories.values()))
    atomic_write(options.out / "frontier.png", stratum_heatmap(first.frontier(), fmt="png"))


if __name__ == "__main__":
    main()
