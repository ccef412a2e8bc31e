"""The oracle, an upper bound: on which conditions a constant residual can succeed at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaforge.demos import Episode
from dynaforge.demos.episode import check_generator_name
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.generator import ConstantResidual, ResidualGenerator
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_whole


@dataclass(frozen=True, slots=True)
class Oracle:
    """The best of the planner and `m` constant residuals, uniform within the scale, for each condition.

    It knows the outcome beforehand, so it is an upper bound and must not collect; a policy that changes its residual
    over time may exceed it.

    Attributes:
        m: Number of constant residuals tried, M.
        name: Its name in reports.
    """

    m: int = 64
    name: str = "oracle"

    def __post_init__(self) -> None:
        check_whole("Oracle: m", self.m, least=1)
        check_generator_name(self.name)

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        """Return the first successful episode, else the one that reached the last checkpoint of all."""
        rng = np.random.default_rng((condition.seed, self.m))
        shape = env.action_space.shape or ()
        best: Episode | None = None
        for k in range(self.m + 1):
            action = rng.uniform(-1.0, 1.0, shape) if k else np.zeros(shape)
            policy = ConstantResidual(action.astype(np.float32))
            episode = ResidualGenerator(policy, name=self.name).attempt(env, condition)
            if best is None or episode.outcome.checkpoint > best.outcome.checkpoint:
                best = episode
            if episode.success:
                return episode
        assert best is not None
        return best
