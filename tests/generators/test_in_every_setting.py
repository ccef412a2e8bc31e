"""Every generator, and what makes its attempts again, in settings other than the default one."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from dynaforge.demos.replay import Replayer
from dynaforge.generators import ConstantResidual, ExploringPolicy, Oracle, PlannerOnly, ResidualGenerator
from dynaforge.generators.generator import make_env
from dynaforge.generators.learner import Learner, LearnerGenerator
from dynaforge.generators.repeat import Repeater
from dynaforge.sim import Condition
from dynaforge.sim.delays import Delays
from dynaforge.sim.setting import Setting
from dynaforge.tasks import Task, get_task

SETTINGS = (
    Setting(reflex="strict", physics="wide", sensing="real"),
    Setting(reflex="off", physics="fixed", sensing="real"),
    Setting(reflex=60.0, physics="wide:hand_delay"),
    Setting(physics="fine"),
)
LEMON = get_task("lemon")
D = np.count_nonzero(LEMON.residual.scales)
NOISY = ResidualGenerator(ExploringPolicy(ConstantResidual(np.full(D, 0.2, np.float32)), 0.5))


def late(task: Task) -> Iterator[Condition]:
    """Yield conditions in which both what is seen and what is commanded is late, if anything is in this setting."""
    for condition in task.conditions.stream("val"):
        delays = Delays.drawn_by(condition, task.setting.sensing)
        if task.setting.sensing == "ideal" or (delays.sensing and delays.action):
            yield condition


def load(task: str) -> Learner:
    """Return a learner that moves the hand toward a place above the table."""
    return lambda observation: np.array((0.45, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0, 0.08, 0.0))


@pytest.mark.parametrize(
    "setting", [SETTINGS[0], *(pytest.param(s, marks=pytest.mark.slow) for s in SETTINGS[1:])], ids=str
)
def test_an_attempt_is_made_again_from_its_recording_to_the_bit(setting: Setting) -> None:
    task = LEMON.under(**setting.to_dict())
    env, repeat, replayer = make_env(NOISY, task), Repeater(task), Replayer(task)
    gated = 0
    for generator, condition in zip((PlannerOnly(), NOISY, Oracle(m=1)), islice(late(task), 3), strict=True):
        episode = generator.attempt(env, condition)
        gated += int(episode.steps["gate"].sum())
        assert repeat(episode).content_hash() == episode.content_hash()
        replay = replayer.replay(episode)
        assert replay.divergence is None
        assert replay.loads == episode.loads
    assert gated
    for each in (env, repeat, replayer):
        each.close()


def test_a_learner_acts_with_real_sensing() -> None:
    task = LEMON.under(**SETTINGS[0].to_dict())
    generator = LearnerGenerator(f"{Path(__file__)}:load")
    env = make_env(generator, task)
    first, again = (generator.attempt(env, condition) for condition in [next(late(task))] * 2)
    assert len(first)
    assert first.content_hash() == again.content_hash()
    env.close()
