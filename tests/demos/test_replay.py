"""A recording simulated again: the same bits, or the first step that differs."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from dynaforge.demos import Episode
from dynaforge.demos.replay import Replayer
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import ExploringPolicy, PlannerOnly, ResidualGenerator
from dynaforge.generators.generator import ConstantResidual
from dynaforge.registration import ENV_NAMES
from dynaforge.tasks import get_task


def recorded(name: str, n: int) -> list[Episode]:
    """Record n episodes, by the planner and under noise in turn."""
    env, episodes = ResidualEnv(name), []
    noisy = ResidualGenerator(ExploringPolicy(ConstantResidual(np.zeros(env.action_space.shape, np.float32)), 0.5))
    for k, condition in enumerate(islice(env.task.conditions.stream("val", n_strata=n), n)):
        episodes.append((PlannerOnly(), noisy)[k % 2].attempt(env, condition))
    env.close()
    return episodes


@pytest.mark.parametrize("name", ENV_NAMES)
def test_a_replay_gives_the_same_bits_and_the_same_outcome(name: str) -> None:
    replayer = Replayer(get_task(name))
    for episode in recorded(name, 3):
        replay = replayer.replay(episode)
        assert replay.divergence is None
        assert replay.success == episode.success
    replayer.close()
    replayer.close()


def test_the_first_step_that_differs_is_named() -> None:
    episode = recorded("can", 1)[0]
    replayer = Replayer(get_task("can"))
    steps = dict(episode.steps)
    steps["joint_reference"] = steps["joint_reference"].copy()
    steps["joint_reference"][20, 3] += 1e-6  # seen in the state that follows
    divergence = replayer.replay(replace(episode, steps=steps)).divergence
    assert divergence is not None
    assert divergence.step == 21
    assert divergence.quantity == "q"
    assert 0.0 < divergence.difference < 1e-5
    assert "q differs from step 21 on" in str(divergence)


def test_an_episode_without_references_or_of_another_task_is_refused() -> None:
    episode = recorded("can", 1)[0]
    with pytest.raises(ValueError, match="belongs to task 'can'"):
        Replayer(get_task("peach")).replay(episode)
    bare = {name: column for name, column in episode.steps.items() if name != "joint_reference"}
    with pytest.raises(ValueError, match="records no joint references"):
        Replayer(get_task("can")).replay(replace(episode, steps=bare))
