"""Film the same conditions twice, planner alone on the left, with the residual on the right: docs/can.gif.

python examples/make_gif.py --task can --policy assets/can/policy.safetensors --out docs/can.gif
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.files.atomic import atomic_write
from dynaforge.generators import PlannerOnly, ResidualGenerator
from dynaforge.reports import encode_gif
from dynaforge.reports.film import film
from dynaforge.tasks import get_task


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", default="can")
    parser.add_argument("--policy", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--difficulty", type=float, nargs="+", default=[0.4, 0.8, 1.1])
    parser.add_argument("--width", type=int, default=640, help="pixels of the whole picture")
    options = parser.parse_args()
    task = get_task(options.task)
    right = ResidualGenerator(MlpPolicyFile.load(options.policy, task=task))
    env = ResidualEnv(task, render_mode="rgb_array")
    frames = []
    for difficulty in options.difficulty:
        condition = next(c for c in task.conditions.stream("val") if abs(c.difficulty - difficulty) < 0.03)
        films = [film(env, generator, condition, every=3) for generator in (PlannerOnly(), right)]
        print(condition.difficulty, *[f"{episode.generator}: {episode.success}" for episode, _ in films])
        length = max(len(shots) for _, shots in films) + 6
        for k in range(length):
            frames.append(np.hstack([shots[min(k, len(shots) - 1)] for _, shots in films]))
    env.close()
    atomic_write(options.out, encode_gif(frames, fps=10, width=options.width))


if __name__ == "__main__":
    main()
