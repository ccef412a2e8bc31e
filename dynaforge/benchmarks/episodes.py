"""Episodes as `dynaforge bench` runs them, with a hash over every bit of their trajectories.

Worker processes import this module, so that nothing here may import torch.
"""

from __future__ import annotations

import hashlib
import os
import time
from itertools import islice
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.residual_env import GateMode, ResidualEnv
from dynaforge.envs.world import ControlStep, World
from dynaforge.geometry import Array
from dynaforge.sim import Condition, SceneState
from dynaforge.tasks import Outcome, Task

N_STRATA = 10
MAX_DECISIONS = 1000  # more than any episode has
HISTORIES = ("nothing", "the same", "a slow one", "a fast one", "one cut short at touch", "random residuals")


def bench_conditions(task: Task, n: int) -> list[Condition]:
    """Return n conditions of the stream `val` that cover the difficulty range evenly."""
    return list(islice(task.conditions.stream("val", n_strata=min(n, N_STRATA)), n))


def run_planner_only(world: World, executor: PhaseExecutor, condition: Condition) -> Outcome:
    """Run an episode of the planner without anything that belongs to a residual: plan, execute, judge.

    Args:
        world: Where it is simulated.
        executor: What plans and judges.
        condition: The condition.
    """
    state = world.reset(condition)
    executor.reset(state, condition, world.reference, sensed=world.sensed)
    while executor.outcome is None:
        state = world.execute(executor.action, None)
        executor.advance(state, world.reference, sensed=world.sensed)
    return executor.outcome


def run_zero_residual(env: ResidualEnv, condition: Condition) -> Outcome:
    """Run the same episode through the env, with residual 0 at every decision."""
    zero = np.zeros(env.action_space.shape or (), np.float32)
    env.reset(options={"condition": condition})
    done = False
    while not done:
        _, _, done, _, _ = env.step(zero)
    assert env.executor.outcome is not None
    return env.executor.outcome


def seeded_actions(space: gym.Space[Any], condition: Condition) -> NDArray[np.float32]:
    """Return a residual action for every decision of an episode, always the same for a condition, shape (T, d)."""
    shape = (MAX_DECISIONS, *(space.shape or ()))
    return np.random.default_rng(condition.seed).uniform(-1, 1, shape).astype(np.float32)


def run_seeded(env: gym.Env[Any, Any], condition: Condition) -> None:
    """Run an episode with the random residuals that belong to its condition (`seeded_actions`)."""
    env.reset(options={"condition": condition})
    for action in seeded_actions(env.action_space, condition):
        _, _, done, _, _ = env.step(action)
        if done:
            break


class TrajectoryHash:
    """A listener of `World` that hashes the measured scene and the joint reference after every control step."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin a new trajectory."""
        self._digest = hashlib.sha256()

    def __call__(self, step: ControlStep) -> None:
        joints, width = step.reference.joints, np.array(step.reference.width)
        for array in (*state_arrays(step.after), joints.q, joints.dq, width):
            self._digest.update(array.tobytes())

    def value(self, outcome: Outcome | None) -> str:
        """Return the hash of the trajectory so far and of how it ended."""
        digest = self._digest.copy()
        digest.update(repr(outcome).encode())
        return digest.hexdigest()[:16]


def state_arrays(state: SceneState) -> list[Array]:
    """Return everything that is measured of a scene, as arrays."""
    arrays = [state.q, state.dq, state.ee.rotation, state.ee.position, np.array((state.time, state.width))]
    for name, body in state.objects.items():
        arrays += [body.pose.rotation, body.pose.position, body.velocity, body.angular_velocity]
        # Only free bodies have an entry in `on_table`.
        arrays.append(np.array((*state.touching[name], state.on_table.get(name, False)), dtype=np.float64))
    return arrays


class HashingEnv(gym.Wrapper[Any, Any, Any, Any]):
    """A residual env that reports the trajectory hash of its current episode, and its process.

    Args:
        task: Task name.
        gate_mode: Gate mode of the env.
    """

    def __init__(self, task: str, gate_mode: GateMode = "skip") -> None:
        self.residual_env = ResidualEnv(task, gate_mode=gate_mode)
        super().__init__(self.residual_env)
        self._hash = TrajectoryHash()
        self.residual_env.world.listeners.append(self._hash)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode and its hash."""
        self._hash.restart()
        return super().reset(seed=seed, options=options)

    def trajectory_hash(self) -> str:
        """Return the hash of the episode since its reset."""
        return self._hash.value(self.residual_env.executor.outcome)

    def pid(self) -> int:
        """Return the id of the process that this env runs in."""
        return os.getpid()


def hashes_over_histories(task: str, conditions: list[Condition]) -> list[dict[str, str]]:
    """Run every condition after each of `HISTORIES` in one env, with the same seeded actions.

    Returns:
        For each condition the trajectory hash by history.
    """
    results = []
    for condition in conditions:
        env = HashingEnv(task)
        hashes = {}
        for history in HISTORIES:
            _simulate_history(env, history, condition)
            hashes[history] = _run_seeded(env, condition)
        env.close()
        results.append(hashes)
    return results


def _simulate_history(env: HashingEnv, history: str, condition: Condition) -> None:
    """Simulate one of `HISTORIES` in this env."""
    inner, space = env.residual_env, env.residual_env.task.conditions
    rng = np.random.default_rng(condition.seed + 1)
    slow, fast = (space.draw(rng, stratum, N_STRATA) for stratum in (0, N_STRATA - 1))
    if history == "the same":
        _run_seeded(env, condition)
    elif history == "a slow one":
        run_zero_residual(inner, slow)
    elif history == "a fast one":
        run_zero_residual(inner, fast)
    elif history == "one cut short at touch":
        zero, done = np.zeros(inner.action_space.shape or (), np.float32), False
        inner.reset(options={"condition": slow})
        while not done and not any(any(fingers) for fingers in inner.world.state.touching.values()):
            _, _, done, _, _ = inner.step(zero)
    elif history == "random residuals":
        _run_seeded(env, space.draw(rng))


def _run_seeded(env: HashingEnv, condition: Condition) -> str:
    run_seeded(env, condition)
    return env.trajectory_hash()


class BusyLoopEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """An env whose step only burns a known CPU time: whatever else a vectorised one costs is overhead.

    Args:
        step_seconds: CPU seconds of a step.
    """

    observation_space = gym.spaces.Box(-1, 1, (64,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (7,), np.float32)

    def __init__(self, step_seconds: float) -> None:
        self._step_seconds = step_seconds

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Return zeros."""
        return np.zeros(64, np.float32), {}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Burn the time; the info is as large as that of a real env."""
        end = time.thread_time() + self._step_seconds
        while time.thread_time() < end:
            pass
        return np.zeros(64, np.float32), 0.0, False, False, {"residual_mask": 1.0, "phase": "close"}

    def processor_time(self) -> tuple[int, float]:
        """Return the id of this env's process, and the CPU seconds that the process has used."""
        return os.getpid(), time.process_time()
