"""In whole episodes, gentle and wild, everything that physics does is possible."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np
import pytest

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import ControlStep
from dynaforge.registration import ENV_NAMES

DEEP_CONTACT = 0.005  # metres of penetration that an impact may make
LONGEST = 3  # control steps that a deep contact may last under the planner: an impact and its rebound
LONGEST_WILD = 6  # and under random residuals at full scale, which press objects down between hand and table
FINGER_SPEED_GAIN = 1.5  # m/s that turning and closing fingers may add to an object, whatever the speed of the hand
CONTACT_RANGE = 0.25  # metres from the hand: nothing of the robot touches an object there


class Watch:
    """Listens to a world; notes contact depths, and what the objects did between control steps."""

    def __init__(self, env: ResidualEnv) -> None:
        self.scene = env.world.scene
        self.steps: list[ControlStep] = []
        self.depths: list[dict[tuple[str, str], float]] = []
        env.world.listeners.append(self)

    def __call__(self, step: ControlStep) -> None:
        self.steps.append(step)
        self.depths.append(self.scene.overlaps())


def watched(task: str, scale: float, n: int) -> list[Watch]:
    env, rng, watches = ResidualEnv(task), np.random.default_rng(6), []
    for k in range(n):
        env.world.listeners.clear()
        watch = Watch(env)
        env.reset(options={"condition": env.condition_sampler.draw(rng, k % 8, 8)})
        done = False
        while not done:
            wild = rng.uniform(-scale, scale, env.action_space.shape)
            _, _, done, _, _ = env.step(wild.astype(np.float32))
        if watch.steps:  # none where the first plan fails
            watches.append(watch)
    env.close()
    return watches


def free_bodies(watch: Watch) -> list[str]:
    return [body.name for body in watch.scene.spec.bodies]


def cases(n: int, **options: Any) -> list[Any]:
    """List n episodes of every task, by planner only and under random residuals at full scale."""
    return [
        pytest.param((name, scale, n), id=f"{name}-{scale:g}-{n}", **options)
        for name in ENV_NAMES
        for scale in (0.0, 1.0)
    ]


@pytest.fixture(scope="module", params=[*cases(2), *cases(48, marks=pytest.mark.slow)])
def episodes(request: pytest.FixtureRequest) -> list[Watch]:
    return watched(*request.param)


def test_nothing_stays_inside_anything_else(episodes: list[Watch]) -> None:
    wild = any(np.any(step.residual) for watch in episodes for step in watch.steps)
    longest = LONGEST_WILD if wild else LONGEST
    for watch in episodes:
        for pair in watch.depths[0]:
            runs = [len(list(run)) for deep, run in groupby(d[pair] > DEEP_CONTACT for d in watch.depths) if deep]
            assert max(runs, default=0) <= longest, pair


def test_nothing_jumps(episodes: list[Watch]) -> None:
    """Between two control steps a body moves no further than the greatest of its speeds allows."""
    for watch in episodes:
        for step in watch.steps:
            for name in free_bodies(watch):
                before, after = step.before.objects[name], step.after.objects[name]
                way = np.linalg.norm(after.pose.position - before.pose.position)
                speed = max(np.linalg.norm(before.velocity), np.linalg.norm(after.velocity))
                near = min(
                    np.linalg.norm(s.ee.position - s.objects[name].pose.position) for s in (step.before, step.after)
                )
                struck = (
                    FINGER_SPEED_GAIN if near < CONTACT_RANGE else 0.0
                )  # and may be struck and stopped again within a control step
                assert way <= (speed + struck) * watch.scene.spec.control_dt + 0.005


def test_no_object_is_faster_than_launch_fall_and_hand_can_make_it(episodes: list[Watch]) -> None:
    for watch in episodes:
        dt = watch.scene.spec.control_dt
        for name in free_bodies(watch):
            launched = watch.steps[0].before.objects[name]
            top, hand = launched.pose.position[2], 0.0
            for step in watch.steps:
                body = step.after.objects[name]
                top = max(top, body.pose.position[2])  # what the hand has lifted may fall
                fallen = np.sqrt(2 * 9.81 * max(0.0, top - body.pose.position[2]))
                hand = max(hand, np.linalg.norm(step.after.ee.position - step.before.ee.position) / dt)
                pushed = max(
                    FINGER_SPEED_GAIN, 2 * hand
                )  # what a heavy hand strikes leaves with twice its speed at most
                assert np.linalg.norm(body.velocity) <= np.linalg.norm(launched.velocity) + pushed + fallen


def test_only_hand_and_gravity_give_an_object_speed_on_the_table(episodes: list[Watch]) -> None:
    """A car that the hand has tilted may gain what it loses in height when it drops back onto all wheels, no more."""
    alone = 0
    for step in (step for watch in episodes for step in watch.steps):
        for name in step.before.on_table:
            before, after = step.before.objects[name], step.after.objects[name]
            hand = (step.before.ee.position, step.after.ee.position)
            away = min(np.linalg.norm(place - after.pose.position) for place in hand) > CONTACT_RANGE
            if away and step.before.on_table[name] and step.after.on_table[name]:
                alone += 1
                drop = max(0.0, before.pose.position[2] - after.pose.position[2])
                assert (
                    np.linalg.norm(after.velocity)
                    <= np.sqrt(before.velocity @ before.velocity + 2 * 9.81 * drop) + 1e-4
                )
    rolling = [s for s in (watch.steps[0].before for watch in episodes) if any(s.on_table.values())]
    assert alone >= 10 * len(rolling)
