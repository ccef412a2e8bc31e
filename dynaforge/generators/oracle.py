"""The oracle, an upper bound: on which conditions a residual that is drawn at random can succeed at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Episode
from dynaforge.demos.episode import check_generator_name
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.generator import ConstantResidual, ResidualGenerator, ResidualPolicy
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_whole


@dataclass(frozen=True, slots=True)
class Oracle:
    """The best of the planner and `m` random residuals, uniform within the scale, for each condition.

    Every other one of them is constant; those between are redrawn for each phase. The draws depend on the condition
    and on their place in the series alone, so more of them succeed wherever fewer do. It knows the outcome beforehand,
    so it is an upper bound and must not collect; a policy that changes its residual within a phase may exceed it.

    Attributes:
        m: Number of residuals tried, M.
        name: Its name in reports.
    """

    m: int = 64
    name: str = "oracle"

    def __post_init__(self) -> None:
        check_whole("Oracle: m", self.m, least=1)
        check_generator_name(self.name)

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        """Return the first successful episode, else the one that reached the last checkpoint of all."""
        best: Episode | None = None
        for k in range(self.m + 1):
            episode = ResidualGenerator(_policy(k, env, condition), name=self.name).attempt(env, condition)
            if best is None or episode.outcome.checkpoint > best.outcome.checkpoint:
                best = episode
            if episode.success:
                return episode
        assert best is not None
        return best


class PhaseResidual:
    """A policy with one residual for each phase.

    Args:
        env: The env in which it acts, which knows the running phase.
        actions: The residual of every phase, shape (C, d).
    """

    def __init__(self, env: ResidualEnv, actions: NDArray[np.float32]) -> None:
        self._env = env
        self.actions = actions

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        action: NDArray[np.float32] = self.actions[self._env.executor.index]
        return action


def _policy(k: int, env: ResidualEnv, condition: Condition) -> ResidualPolicy:
    """Return the k-th policy to try: zero, then in turn a constant residual and one for each phase."""
    shape, rng = env.action_space.shape or (), np.random.default_rng((condition.seed, k))
    if k == 0:
        return ConstantResidual(np.zeros(shape, np.float32))
    if k % 2:
        return ConstantResidual(rng.uniform(-1.0, 1.0, shape).astype(np.float32))
    return PhaseResidual(env, rng.uniform(-1.0, 1.0, (len(env.task.phases), *shape)).astype(np.float32))
