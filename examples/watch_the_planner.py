"""Watch the planner catch slow objects and miss fast ones, and what a learned residual makes of the same conditions.

python examples/watch_the_planner.py --task can --film runs/can.gif
python examples/watch_the_planner.py --task can --policy runs/can-1/policy.safetensors --film runs/can.gif

The policy is one that `dynaforge forge --task can` has trained.
"""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path

import numpy as np

from dynaforge import PlannerOnly, ResidualEnv, get_task
from dynaforge.generators import make_generator
from dynaforge.reports import encode_gif
from dynaforge.reports.film import film


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="can", help="a task's name or file")
    parser.add_argument("--policy", type=Path, help="a residual policy, shown to the right of the planner")
    parser.add_argument("--conditions", type=int, default=3, help="how many, from easy to hard")
    parser.add_argument("--film", type=Path, help="write a GIF here; needs the extra [report]")
    options = parser.parse_args()

    task = get_task(options.task)
    generators = [PlannerOnly()]
    if options.policy:
        generators.append(make_generator("residual", task, policy=options.policy))
    env = ResidualEnv(task, render_mode="rgb_array")
    frames: list[np.ndarray] = []
    # One condition of each stratum, that is, of n equal parts of the difficulty range.
    for condition in islice(task.conditions.stream("val", n_strata=options.conditions), options.conditions):
        print(f"{task.conditions.difficulty} {condition.difficulty:.2f}:")
        shots = []
        for generator in generators:
            episode = generator.attempt(env, condition)
            print(f"  {generator.name}: {'success' if episode.success else episode.failure}")
            if options.film:  # the same condition again gives the same episode, bit for bit
                shots.append(film(env, generator, condition, every=3)[1])
        if not shots:
            continue
        length = max(map(len, shots)) + 6  # the last picture stays for 0.6 s
        frames += [np.hstack([side[min(k, len(side) - 1)] for side in shots]) for k in range(length)]
    env.close()
    if options.film:
        options.film.parent.mkdir(parents=True, exist_ok=True)
        options.film.write_bytes(encode_gif(frames, fps=10, width=320 * len(generators)))
        print(f"film {options.film}")


if __name__ == "__main__":
    main()
