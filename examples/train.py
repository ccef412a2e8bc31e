"""Train a residual policy with FrontierGRPO on all cores, and measure what it adds to the planner.

python examples/train.py --task can --steps 50000      # about five minutes on two cores
"""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path

from stable_baselines3.common.env_util import make_vec_env

from dynaforge import (
    FrontierGRPO,
    MlpPolicyFile,
    PlannerOnly,
    ResidualGenerator,
    SharedMemoryVecEnv,
    get_task,
    recommended,
    run_attempts,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="can", help="one of the nine tasks")
    parser.add_argument("--steps", type=int, default=50_000, help="environment steps; the update under way is finished")
    parser.add_argument("--groups", type=int, default=16, help="conditions per update, one of each stratum")
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--attempts", type=int, default=60, help="conditions to measure on")
    parser.add_argument("--out", type=Path, default=Path("runs/policy.safetensors"))
    options = parser.parse_args()

    task = get_task(options.task)
    env_id = f"DynaForge/{task.env_name}-v0"
    env = make_vec_env(env_id, n_envs=options.envs, vec_env_cls=SharedMemoryVecEnv)
    settings = recommended(env_id, n_groups=options.groups)
    model = FrontierGRPO("MlpPolicy", env, seed=0, verbose=1, **settings)
    model.learn(options.steps)
    env.close()

    policy = MlpPolicyFile.of(model, task=task)  # weights and JSON: loading it runs no code
    options.out.parent.mkdir(parents=True, exist_ok=True)
    policy.save(options.out)
    print(f"policy {options.out}")
    for generator in (PlannerOnly(), ResidualGenerator(policy)):
        # The same conditions for both; training never uses those of this stream.
        conditions = islice(task.conditions.stream("val"), options.attempts)
        successes = [result.attempt.success for result in run_attempts(task, generator, conditions)]
        print(f"{generator.name}: success on {sum(successes)} of {len(successes)} conditions")


if __name__ == "__main__":  # worker processes import this file
    main()
