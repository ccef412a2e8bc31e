"""Repetition of an attempt from its recording: the planner plans anew; only the residual comes from the recording."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Episode
from dynaforge.demos.prescription import FREE
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.generator import episode_of
from dynaforge.generators.recording import Recorder
from dynaforge.generators.replay import SynchronisedReplay
from dynaforge.tasks import Outcome, Task


class Repeater:
    """Makes recorded attempts at one task again; use one for many of them.

    Args:
        task: The task.
    """

    def __init__(self, task: Task) -> None:
        self._env = ResidualEnv(task, share_prefix=False)

    def __call__(self, episode: Episode) -> Episode:
        """Make the attempt of an episode again and record it; a genuine recording is repeated bit for bit.

        The action is taken from the recorded residual at the beginning of each decision, as far as a policy could have
        asked for it, and kept during the decision. The executor decides when the episode ends, not the recording. Where
        the motion of an object is prescribed, the path is drawn anew too, and nothing comes from the recording but the
        options of its generator.

        Raises:
            ValueError: The condition is not one of the task, or no residual was recorded, or what it notes on a
                prescribed motion is malformed.
        """
        if episode.dynamics != FREE:
            self._env.world.task.conditions.validate(episode.condition)
            return SynchronisedReplay.of(episode).attempt(self._env, episode.condition)
        residuals = episode.steps.get("residual_action")
        if len(episode) and (residuals is None or residuals.shape[1] != 7):
            raise ValueError("it records no residual_action of 7 components, so its attempt cannot be made again")
        world = self._env.world
        recorder = Recorder(self._env.task, world.kinematics)
        with world.listening(recorder):
            outcome = self._run(episode, residuals if residuals is not None else np.zeros((0, 7)))
        return episode_of(
            self._env,
            recorder,
            outcome,
            episode.condition,
            generator=episode.generator,
            policy_hash=str(episode.meta.get("policy_hash", "")),
        )

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._env.close()

    def _run(self, episode: Episode, residuals: NDArray[np.float64]) -> Outcome:
        world, executor = self._env.world, self._env.executor
        state = world.reset(episode.condition)
        executor.reset(state, episode.condition, world.reference, sensed=world.sensed)
        scale, action = self._env.residual_scale, np.zeros(self._env.residual_scale.size)
        steps_left = 0  # of the decision
        for recorded in residuals:
            if executor.outcome is not None:
                break
            if not executor.action.gate:
                steps_left = 0
            elif steps_left == 0:
                action = scale.nearest_action(recorded, executor)
                steps_left = self._env.task.residual.decision_steps
            state = world.execute(executor.action, scale.physical(action, executor))
            executor.advance(state, world.reference, sensed=world.sensed)
            steps_left = max(steps_left - 1, 0)
        return executor.outcome or Outcome(
            success=False,
            checkpoint=executor.index,
            n_checkpoints=self._env.task.n_checkpoints,
            failure="it continues after its last recorded step",
            phase=executor.phase.name,
        )
