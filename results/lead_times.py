"""Choose the lead time of the planner that predicts: the one with the most successes on `val`, for each task.

    python results/lead_times.py                        # measures, prints, and stores attempts in runs/lead_times
    python results/lead_times.py --task can --write     # and writes the choice to assets/lead_times.json

The rule was written before anything was measured: 100 conditions of `val` (block 0) for each of the lead times below,
planner only; the lead time with the most successes, and of several the shortest. Nothing of `test` is looked at. It
resumes: what is stored is not attempted again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from dynaforge.files.atomic import atomic_write
from dynaforge.generators.measurements import Measurement
from dynaforge.generators.pairs import Pair
from dynaforge.generators.prediction import LEAD_TIMES, Prediction
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import TASK_NAMES, Task, get_task

GRID = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""Seconds. The hand trails a moving target by about a tenth of a second, and closes in a quarter."""
CONDITIONS = 100


def measured(task: Task, lead: float, out: Path, workers: int | None) -> Measurement:
    """Return the attempts with a lead time, of which those that are stored are not made again."""
    row = f"lead-{1000 * lead:.0f}ms"
    generator, path = Prediction(lead), out / task.name / f"{row}.json"
    pair = Pair(task=task, row=row, generator=generator, stream="val", blocks=1, attempts=CONDITIONS, path=path)
    return pair.measure(workers=workers)


def main() -> None:
    """Measure, print the successes by lead time, and choose."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", nargs="+", choices=TASK_NAMES, default=list(TASK_NAMES))
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, default=Path("runs/lead_times"))
    parser.add_argument("--write", action="store_true", help="write the choice to the package's assets")
    options = parser.parse_args()
    chosen: dict[str, float] = {}
    print(f"{'seconds':<12}{''.join(f'{lead:>6g}' for lead in GRID)}  best")
    for name in options.task:
        found = {lead: sum(measured(get_task(name), lead, options.out, options.workers).success) for lead in GRID}
        chosen[name] = max(GRID, key=lambda lead: (found[lead], -lead))
        print(f"{name:<12}{''.join(f'{found[lead]:>6}' for lead in GRID)}  {chosen[name]:g}", flush=True)
    if options.write:
        path = asset_path(LEAD_TIMES)
        atomic_write(path, json.dumps(json.loads(path.read_text()) | chosen, indent=1).encode() + b"\n")
        print(f"written to {path}")


if __name__ == "__main__":
    main()
