"""A small dataset of every task: collected, verified, rendered, exported, and a page to look through it.

    python examples/sample_datasets.py --out data --demos 20

Any interruption: the same command goes on.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from dynaforge.cli.main import main
from dynaforge.tasks import TASK_NAMES

INTERRUPTED = 130  # status of a command that was stopped with Ctrl-C


def sample(task: str, out: Path, demos: int) -> list[str]:
    """Make the dataset of a task; return the steps that reported a problem."""
    folder = out / task
    steps = (
        ["collect", "--task", task, "--demos", str(demos), "--out", str(folder)],
        ["verify", str(folder), "--replay", "--audit"],
        ["render", str(folder), "--cameras", "front", "wrist", "--points", "1024"],
        ["export", str(folder), "--format", "lerobot"],
        ["view", str(folder), "--limit", "8"],
    )
    problems = []
    for step in steps:
        if step[0] == "export":  # always of all that the folder holds now
            shutil.rmtree(out / f"{task}-lerobot", ignore_errors=True)
        print(f"\n$ dynaforge {' '.join(step)}", flush=True)
        status = main(step)
        if status == INTERRUPTED:
            sys.exit(status)
        if status:
            problems.append(f"{task}: `dynaforge {step[0]}` reported a problem")
    return problems


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("data"), help="a folder a task is made in it")
    parser.add_argument("--demos", type=int, default=20, help="successes of each task")
    parser.add_argument("--task", nargs="+", default=list(TASK_NAMES), choices=TASK_NAMES)
    options = parser.parse_args()
    found = [problem for name in options.task for problem in sample(name, options.out, options.demos)]
    print("\n" + ("\n".join(found) or f"{len(options.task)} datasets in {options.out}, no problems"))
    sys.exit(1 if found else 0)
