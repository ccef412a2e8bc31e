"""The oracle: for each condition, the best of many residuals drawn at random, constant ones and ones with feedback."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Episode
from dynaforge.demos.episode import check_generator_name
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.generator import ConstantResidual, ResidualGenerator, ResidualPolicy
from dynaforge.geometry import Array
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_whole

MAX_PROPORTIONAL = 1.0  # metres of residual per metre of offset
MAX_INTEGRAL = 5.0  # metres of residual per metre of offset and second
MAX_LEAD = 0.2  # seconds; the arm trails what it follows by about half as much


@dataclass(frozen=True, slots=True)
class Oracle:
    """The best of the planner and `m` random residuals for each condition: a lower bound of what a policy can reach.

    It is found by search: a condition that it wins can be won within the residual's scale, by one of three simple kinds
    of policy; one that it loses may be won by a better policy or a longer search. In turn the residuals are constant,
    redrawn for each phase (both uniform within the scale), and with feedback (`FeedbackResidual`), of whose terms each
    is drawn or left out. The draws depend on the condition and on their place in the series alone, so more of them
    succeed wherever fewer do. It knows the outcome of every try before it chooses, so it must not collect.

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


class FeedbackResidual:
    """A policy with feedback, for one episode: it makes up for what the hand trails the planner's target by.

        residual = lead * v + proportional * e + i,    i <- clip(i + integral * dt * e, -scale, scale)

    e is the planner's target minus the hand's position, metres; v the velocity of the phase's object, m/s; both in the
    object's heading frame, as the observation at the start of a decision of dt seconds gives them. The residual is a
    translation, metres; it turns neither hand nor fingers. Then it is expressed in the residual's frame and clipped to
    the phase's scale. It is zero for a hand that has always been on its target, with the object at rest or no lead.
    A constant residual may be added to it; the sum is clipped again.

    Args:
        env: The env in which it acts.
        proportional: Metres of residual per metre of offset.
        integral: Metres of residual per metre of offset and second.
        lead: Seconds by which the hand aims ahead of the object.
        upward: Whether the vertical part acts too.
        constant: The residual that is added, in units of its scale, shape (d,).
    """

    def __init__(
        self,
        env: ResidualEnv,
        *,
        proportional: float,
        integral: float,
        lead: float,
        upward: bool = True,
        constant: float | Array = 0.0,
    ) -> None:
        self._env = env
        self._constant = constant
        self.gains = (proportional, integral, lead)
        self._axes = np.array((1.0, 1.0, float(upward)))
        self._scale = np.array(env.task.residual.translation)
        self._dt = env.task.residual.decision_steps * env.task.scene.control_dt
        self._sum = np.zeros(3)

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        offset = self._seen("plan_from_ee", observation)
        velocity = self._seen("object_velocity[0]", observation)
        proportional, integral, lead = self.gains
        self._sum = (self._sum + integral * self._dt * offset).clip(-self._scale, self._scale)
        env, residual = self._env, np.zeros(7)
        residual[:3] = env.executor.frame.rotation @ (lead * velocity + proportional * offset + self._sum)
        action: Array = self._constant + env.residual_scale.nearest_action(residual, env.executor)
        return action.clip(-1.0, 1.0).astype(np.float32)

    def _seen(self, name: str, observation: NDArray[np.float32]) -> Array:
        """Return a vector of the observation, SI units, without its vertical part where that does not act."""
        return self._axes * self._env.observer.read(name, observation)


def _policy(k: int, env: ResidualEnv, condition: Condition) -> ResidualPolicy:
    """Return the k-th policy to try: zero, then in turn a constant residual, one for each phase, one with feedback."""
    shape, rng = env.action_space.shape or (), np.random.default_rng((condition.seed, k))
    if k == 0:
        return ConstantResidual(np.zeros(shape, np.float32))
    if k % 3 == 1:
        return ConstantResidual(rng.uniform(-1.0, 1.0, shape).astype(np.float32))
    if k % 3 == 2:
        return PhaseResidual(env, rng.uniform(-1.0, 1.0, (len(env.task.phases), *shape)).astype(np.float32))
    # Each term is there or not: feedback wins where the hand must stay on something, a constant where it must block it.
    *switches, upward = rng.integers(2, size=5)
    proportional, integral, lead = switches[:3] * rng.uniform(0.0, (MAX_PROPORTIONAL, MAX_INTEGRAL, MAX_LEAD))
    return FeedbackResidual(
        env,
        proportional=proportional,
        integral=integral,
        lead=lead,
        upward=bool(upward),
        constant=switches[3] * rng.uniform(-1.0, 1.0, shape),
    )
