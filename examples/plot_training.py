"""Draw the learning curves of stored runs, and the frontier of the first one.

python examples/plot_training.py results/can/seed-0 results/can/seed-1 results/can/seed-2 --out results/can
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from dynaforge.demos import atomic_write
from dynaforge.evaluation import frontier_of_outcomes
from dynaforge.reports import learning_curve, stratum_heatmap


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", help="folders with a history.json of `dynaforge forge`")
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    success = {run.name: np.array(json.loads((run / "history.json").read_text())["success"]) for run in options.runs}
    curves = {name: outcomes.mean(axis=(1, 2)) for name, outcomes in success.items()}
    atomic_write(options.out / "learning.png", learning_curve(curves, fmt="png"))
    first = next(iter(success.values()))
    atomic_write(options.out / "frontier.png", stratum_heatmap(frontier_of_outcomes(first), fmt="png"))


if __name__ == "__main__":
    main()
