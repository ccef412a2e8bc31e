"""Figures of the shared prefix: what a group of rollouts costs with it and without, and that its bits are the same."""

from __future__ import annotations

import time
from statistics import fmean

import numpy as np

from dynaforge.benchmarks.episodes import bench_conditions
from dynaforge.benchmarks.figure import Figure, tracked
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.sim import Condition
from dynaforge.tasks import TASK_NAMES, Task, get_task

MAX_RATIO = 0.8  # of the CPU time of rollouts, mean of the tasks


def shared_prefix(*, tasks: tuple[str, ...] = TASK_NAMES, n_groups: int = 3, group_size: int = 8) -> list[Figure]:
    """Compare the CPU time of groups of rollouts that share what comes before their first gate with that of others.

    Both take turns, with the same conditions and random residuals, in the gate mode in which `FrontierGRPO` trains.

    Args:
        tasks: Names of the tasks.
        n_groups: Groups for each task.
        group_size: Rollouts in a group.
    """
    seconds = {}
    equal = 0
    for name in tracked(tasks, "prefix", total=len(tasks)):
        shared, alone, same = _compare(get_task(name), n_groups, group_size)
        seconds[name] = {"shared": shared, "alone": alone}
        equal += same
    ratios = {name: each["shared"] / each["alone"] for name, each in seconds.items()}
    n = len(tasks) * n_groups * group_size
    mean = fmean(ratios.values())
    return [
        Figure(
            title=f"rollouts that share their prefix, {n_groups} groups of {group_size}, {len(tasks)} tasks: CPU",
            target="<= 0.8 of others, mean; all bits equal",
            measured=f"{mean:.2f} ({min(ratios.values()):.2f} to {max(ratios.values()):.2f}); {equal} of {n} equal",
            ok=mean <= MAX_RATIO and equal == n,
            raw={"cpu_seconds": seconds, "equal": equal},
        )
    ]


def _compare(task: Task, n_groups: int, group_size: int) -> tuple[float, float, int]:
    """Return the CPU seconds with sharing and without, and how many rollouts are the same."""
    envs = [ResidualEnv(task, gate_mode="mask", share_prefix=share) for share in (True, False)]
    seconds, equal = [0.0, 0.0], 0
    for condition in bench_conditions(task, n_groups):
        for rollout in range(group_size):
            answers = []
            for k, env in enumerate(envs):
                begin = time.process_time()
                answers.append(_answers(env, condition, rollout))
                seconds[k] += time.process_time() - begin
            equal += answers[0] == answers[1]
    for env in envs:
        env.close()
    return seconds[0], seconds[1], equal


def _answers(env: ResidualEnv, condition: Condition, rollout: int) -> list[bytes | float]:
    """Run an episode with random residuals; return its observations and rewards."""
    rng = np.random.default_rng((condition.seed, rollout))
    observation, _ = env.reset(options={"condition": condition})
    answers: list[bytes | float] = [observation.tobytes()]
    done = False
    while not done:
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        observation, reward, done, _, _ = env.step(action)
        answers += (observation.tobytes(), reward)
    return answers
