"""Collect demonstrations of the planner or of a policy, and look at what they contain; the same command resumes.

python examples/collect_and_look.py --task can --demos 20 --out data/can
python examples/collect_and_look.py --task can --policy runs/can-1/policy.safetensors --demos 200 --out data/can-1
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

from dynaforge import (
    DemonstrationDataset,
    Generator,
    Goal,
    PlannerOnly,
    collect,
    get_task,
)
from dynaforge.generators import make_generator


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="can", help="one of the nine tasks")
    parser.add_argument("--policy", type=Path, help="a residual policy; the planner by itself without one")
    parser.add_argument("--demos", type=int, default=20, help="successes to collect")
    parser.add_argument("--out", type=Path, default=Path("data/can"))
    parser.add_argument("--workers", type=int, help="processes; all cores by default")
    options = parser.parse_args()

    task = get_task(options.task)
    generator: Generator = PlannerOnly()
    if options.policy:
        generator = make_generator("residual", task, policy=options.policy)
    dataset = DemonstrationDataset(options.out, task=task.name)
    collect(dataset, task, generator, Goal(options.demos, attempts=None), workers=options.workers)

    # The ledger lists every attempt, failed ones too, so the rate is an honest one.
    reasons = Counter(attempt.failure or "success" for attempt in dataset.attempts())
    print(f"{len(dataset)} demonstrations, {dataset.dgr():.0%} of all attempts: {dict(reasons)}")
    body = task.scene.bodies[0].name
    for episode in list(dataset)[:5]:
        steps = episode.steps  # one row per control step, 30 per second
        gap = np.linalg.norm(steps["ee_position"] - steps[f"object/{body}/position"], axis=1)
        phases = [episode.meta["phases"][k] for k in dict.fromkeys(steps["phase"].tolist())]
        print(
            f"{episode.id}: difficulty {episode.condition.difficulty:.2f}, {len(gap)} steps, "
            f"hand to {body} {gap[0]:.2f} m at first, {gap.min():.3f} m at closest; {' > '.join(phases)}"
        )
    print(f"a page with clips and plots: dynaforge view {options.out}")


if __name__ == "__main__":  # worker processes import this file
    main()
