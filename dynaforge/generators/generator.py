"""Generators in a `ResidualEnv`: they turn a condition into an episode, with the planner only or with a residual."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Episode
from dynaforge.demos.episode import check_generator_name
from dynaforge.demos.schema import state_digests
from dynaforge.envs.base import WorldEnv
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.recording import Recorder
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_callable, check_kind, check_number, finite_array
from dynaforge.sim.setting import Setting
from dynaforge.tasks import Outcome, Task
from dynaforge.tasks.digest import task_digest

PACKAGES = ("dynaforge", "pybullet", "pin", "toppra", "ruckig", "numpy")


class ResidualPolicy(Protocol):
    """Maps an observation to a residual action in [-1, 1]; picklable."""

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the residual, shape (d,)."""
        ...


class Generator(Protocol):
    """Attempts conditions; picklable, so that workers can run it.

    A generator that acts in another env than `ResidualEnv` has a method `make_env(task)`, which returns that env. One
    that changes the task, as `Prediction` does the lead time of its planner, has a method `attempted(task)`, which
    returns what it attempts instead.
    """

    @property
    def name(self) -> str:
        """Its name in ledgers and reports."""
        ...

    def attempt(self, env: Any, condition: Condition) -> Episode:
        """Run one episode, successful or not."""
        ...


def attempted_task(generator: Generator, task: Task) -> Task:
    """Return the task as a generator attempts it: the same conditions, but perhaps another planner."""
    change: Callable[[Task], Task] | None = getattr(generator, "attempted", None)
    return task if change is None else change(task)


def make_env(generator: Generator, task: Task) -> Any:
    """Return a new env for a generator to act in."""
    make: Callable[[Task], Any] | None = getattr(generator, "make_env", None)
    task = attempted_task(generator, task)
    # Attempts are listened to, so that they share no prefix.
    return ResidualEnv(task, share_prefix=False) if make is None else make(task)


class ResidualGenerator:
    """The planning prior with a residual policy on top, without exploration.

    Args:
        policy: The residual policy.
        policy_hash: Digest of its weights, stored with every episode.
        name: Its name in ledgers and reports.
        trained_under: The setting that the policy was trained under, where it is known.
    """

    def __init__(
        self,
        policy: ResidualPolicy,
        *,
        policy_hash: str = "",
        name: str = "residual",
        trained_under: Setting | None = None,
    ) -> None:
        check_callable("policy", policy, expected="a function of an observation")
        check_kind("policy_hash", policy_hash, str)
        check_generator_name(name)
        self.policy = policy
        check_kind("trained_under", trained_under, (Setting, type(None)))
        self.policy_hash = policy_hash
        self.name = name
        self.trained_under = trained_under

    @property
    def policy_origin(self) -> dict[str, Any]:
        """Which policy this is, as plain data: its digest, and the setting that it was trained under where known."""
        setting = None if self.trained_under is None else self.trained_under.to_dict()
        return {"policy": self.policy_hash, "trained_under": setting}

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        """Run one episode under a condition and record it, Eq. 1."""
        recorder = Recorder(env.task, env.world.kinematics)
        with env.world.listening(recorder):
            observation, _ = env.reset(options={"condition": condition})
            done = False
            while not done:
                observation, _, done, _, _ = env.step(self.policy(observation))
        assert env.executor.outcome is not None
        return episode_of(
            env, recorder, env.executor.outcome, condition, generator=self.name, policy_hash=self.policy_hash
        )


def episode_of(
    env: WorldEnv, recorder: Recorder, outcome: Outcome, condition: Condition, *, generator: str, policy_hash: str
) -> Episode:
    """Return the episode of an attempt that has just ended.

    Args:
        env: The env in which it ran.
        recorder: What recorded it.
        outcome: How it ended.
        condition: Its condition.
        generator: Name of the generator.
        policy_hash: Digest of the policy; "" without one.
    """
    steps = recorder.arrays(outcome.episodic_return())
    touched = steps["left_contact"] | steps["right_contact"] if steps else None
    planned = steps["phase"] >= env.task.contact_phase if "phase" in steps else None
    return Episode(
        condition=condition,
        generator=generator,
        outcome=outcome,
        duration=env.world.state.time,
        loads=env.world.scene.loads,
        steps=steps,
        meta={
            "phases": [phase.name for phase in env.task.phases],
            "planned_contact_time": _first_time(steps, planned),
            "contact_time": _first_time(steps, touched),
            "state_digests": state_digests(steps),
            "task_hash": task_digest(env.task),
            "policy_hash": policy_hash,
            "versions": {name: version(name) for name in PACKAGES},
        },
    )


def _first_time(steps: Mapping[str, NDArray[Any]], condition: NDArray[np.bool_] | None) -> float | None:
    """Return the simulated time of the first step at which a condition is true; None if it never is."""
    found = np.flatnonzero(condition) if condition is not None else np.empty(0, int)
    return float(steps["time"][found[0]]) if len(found) else None


class ConstantResidual:
    """A policy with the same residual at every decision.

    Args:
        action: The residual, shape (d,).
    """

    def __init__(self, action: NDArray[np.float32]) -> None:
        finite_array("action", action, np.shape(action))
        self.action = action

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        return self.action


class ExploringPolicy:
    """A policy with exploration noise, Eq. 4, whose seed is the observation, so that episodes are reproducible.

    Args:
        policy: Returns the mean of the residual.
        sigma: Standard deviation of the noise, in units of the residual's scale.
    """

    def __init__(self, policy: ResidualPolicy, sigma: float) -> None:
        check_callable("policy", policy, expected="a function of an observation")
        check_number("sigma", sigma, least=0.0)
        self.policy = policy
        self.sigma = sigma

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        mean = self.policy(observation)
        rng = np.random.default_rng(zlib.crc32(observation.tobytes()))
        return np.clip(mean + self.sigma * rng.standard_normal(mean.shape), -1.0, 1.0).astype(np.float32)


class PlannerOnly:
    """The planner only: the same episode with a residual of zero."""

    name = "planner_only"

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        """Run one episode and record it."""
        zero = ConstantResidual(np.zeros(env.action_space.shape or (), np.float32))
        return ResidualGenerator(zero, name=self.name).attempt(env, condition)
