"""Figures of exactness: one condition and the same actions give one trajectory, bit for bit."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from dynaforge.benchmarks.episodes import (
    HashingEnv,
    TrajectoryHash,
    bench_conditions,
    hashes_over_histories,
    run_planner_only,
    run_zero_residual,
    seeded_actions,
)
from dynaforge.benchmarks.figure import Figure, tracked
from dynaforge.envs.residual_env import GATE_MODES, ResidualEnv
from dynaforge.sampling.processes import begin_worker, worker_environment
from dynaforge.sampling.vector_env import SharedMemoryVecEnv
from dynaforge.sim import Condition
from dynaforge.tasks import Task, get_task

PROCESS_TIMEOUT = 180.0  # seconds for all the episodes of the second process
N_DECISIONS_BEFORE = 12  # of other episodes in every env of a vectorised one


def zero_residual(task: Task, *, n: int = 20) -> list[Figure]:
    """Compare whole planner-only episodes with the same episodes through the env at residual 0, in all gate modes.

    Args:
        task: The task.
        n: Conditions.
    """
    envs = {mode: ResidualEnv(task, gate_mode=mode) for mode in GATE_MODES}
    plain = envs[GATE_MODES[0]]
    raw, different = [], 0
    for condition in tracked(bench_conditions(task, n), "zero residual", total=n):
        hashes = {"planner only": _hash_of(plain, partial(run_planner_only, plain.world, plain.executor), condition)}
        for mode, env in envs.items():
            hashes[f"env, {mode}"] = _hash_of(env, partial(run_zero_residual, env), condition)
        different += len(set(hashes.values())) > 1
        raw.append({"condition": condition.id, **hashes})
    for env in envs.values():
        env.close()
    return [
        Figure(
            title="zero residual is planner only",
            target="bit for bit, whole episodes",
            measured=f"{n - different} of {n} episodes equal in {' and '.join(GATE_MODES)} mode",
            ok=not different,
            raw={"episodes": raw},
        )
    ]


def one_trajectory(task: Task, *, n: int = 3, sizes: tuple[int, ...] = (1, 4, 16)) -> list[Figure]:
    """Run conditions after several histories, in a second process and in vectorised envs; count distinct trajectories.

    Args:
        task: The task.
        n: Conditions, spread over the difficulty range.
        sizes: Numbers of envs in the vectorised envs.
    """
    conditions = [task.conditions.draw(np.random.default_rng(i), i, n) for i in range(n)]
    spawn = multiprocessing.get_context("spawn")  # a fork server has imported the envs already
    with worker_environment(), ProcessPoolExecutor(1, mp_context=spawn, initializer=begin_worker) as pool:
        future = pool.submit(hashes_over_histories, task.name, conditions)
        here = hashes_over_histories(task.name, conditions)
        there = future.result(timeout=PROCESS_TIMEOUT)
    vectorised = {size: hashes_in_vector(task.name, conditions, n_envs=size) for size in tracked(sizes, "env counts")}
    raw, distinct, runs = [], [], 0
    for k, condition in enumerate(conditions):
        hashes = {f"this process, after {name}": value for name, value in here[k].items()}
        hashes |= {f"other process, after {name}": value for name, value in there[k].items()}
        for size, table in vectorised.items():
            hashes |= {f"env {i} of {size}": value for i, value in enumerate(table[k])}
        distinct.append(len(set(hashes.values())))
        runs += len(hashes)
        raw.append({"condition": condition.id, "difficulty": condition.difficulty, "hashes": hashes})
    counts = ", ".join(map(str, distinct))
    return [
        Figure(
            title=f"one condition: {len(here[0])} histories, 2 processes, {'/'.join(map(str, sizes))} envs",
            target="one trajectory hash each",
            measured=f"{counts} hash(es) for {n} conditions, {runs} episodes",
            ok=set(distinct) == {1},
            raw={"conditions": raw},
        )
    ]


def hashes_in_vector(task: str, conditions: list[Condition], *, n_envs: int, n_workers: int = 2) -> list[list[str]]:
    """Run every condition with the seeded actions in all envs of a vectorised env, after a history of its own in each.

    Args:
        task: Task name.
        conditions: The conditions.
        n_envs: Number of envs.
        n_workers: Number of worker processes.

    Returns:
        For each condition the trajectory hashes of all envs.
    """
    space = get_task(task).conditions
    env = SharedMemoryVecEnv([partial(HashingEnv, task)] * n_envs, n_workers=n_workers)
    try:
        env.park_when_done(True)
        results = []
        for k, condition in enumerate(conditions):
            rng = np.random.default_rng((k, n_envs))
            for index in range(n_envs):
                env.assign(index, space.reset_kwargs(space.draw(rng)))
            shape = (n_envs, *(env.action_space.shape or ()))
            for _ in range(N_DECISIONS_BEFORE):
                env.step(rng.uniform(-1, 1, shape).astype(np.float32))
            results.append(_run_everywhere(env, condition, space.reset_kwargs(condition)))
        return results
    finally:
        env.close()


def _run_everywhere(env: SharedMemoryVecEnv, condition: Condition, reset_kwargs: dict[str, object]) -> list[str]:
    for index in range(env.num_envs):
        env.assign(index, reset_kwargs)
    env.step(np.zeros((env.num_envs, *(env.action_space.shape or ())), np.float32))
    ended = np.zeros(env.num_envs, dtype=bool)
    for action in seeded_actions(env.action_space, condition):
        ended |= env.step(np.tile(action, (env.num_envs, 1)))[2]
        if ended.all():
            break
    return env.env_method("trajectory_hash")


def _hash_of(env: ResidualEnv, run: Callable[[Condition], object], condition: Condition) -> str:
    trajectory = TrajectoryHash()
    with env.world.listening(trajectory):
        run(condition)
    return trajectory.value(env.executor.outcome)
