"""What every registered env must keep, whatever its task."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import dynaforge
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.registration import ENV_NAMES
from dynaforge.sim import Condition, SceneState
from dynaforge.tasks import Task

assert dynaforge.__version__

# Every id as registered; the other modes, which no task has to itself, on one task.
VARIANTS = [
    (f"DynaForge/{name}{kind}-v0", {key: mode})
    for name in ENV_NAMES.values()
    for kind, key, modes in (("", "gate_mode", ("skip", "mask")), ("Task", "action_mode", ("ee", "joint")))
    for mode in modes[: 2 if name == "Can" else 1]
]
NAMES = [f"{name.removeprefix('DynaForge/')}-{next(iter(kwargs.values()))}" for name, kwargs in VARIANTS]
RESIDUAL_INFO = {"is_success", "checkpoint", "failure", "phase", "condition_id", "difficulty", "residual_mask"}
TASK_INFO = {"is_success", "failure", "condition_id", "difficulty"}


@pytest.fixture(scope="module", params=VARIANTS, ids=NAMES)
def env(request: pytest.FixtureRequest):
    name, kwargs = request.param
    env = gym.make(name, **kwargs)
    yield env
    env.close()


def drawn(env: gym.Env, seed: int, stratum: int = 2) -> Condition:
    return env.unwrapped.condition_sampler.draw(np.random.default_rng(seed), stratum, 8)


@dataclass(frozen=True)
class RandomEpisode:
    """What each step of an episode of random actions gave, and the state it led to."""

    condition: Condition
    results: list[tuple[Any, ...]]
    states: list[SceneState]


def random_episode(env: gym.Env, condition: Condition, rng: np.random.Generator, scale: float = 1.0) -> RandomEpisode:
    low, high = env.action_space.low, env.action_space.high
    middle, half = (low + high) / 2, scale * (high - low) / 2
    env.reset(options={"condition": condition})
    episode = RandomEpisode(condition, [], [])
    while not episode.results or not episode.results[-1][2]:
        chosen = middle + half * rng.uniform(-1.0, 1.0, low.shape)
        episode.results.append(env.step(chosen.astype(np.float32)))
        episode.states.append(env.unwrapped.world.state)
    return episode


@pytest.fixture(scope="module")
def episodes(env: gym.Env) -> list[RandomEpisode]:
    """Some episodes by the planner (no residual), gentle and wild."""
    rng = np.random.default_rng(2)
    if isinstance(env.unwrapped, ResidualEnv):
        chosen = [
            (4, 0, 0.0),
            (5, 0, 0.05),
            (6, 0, 0.1),
            (4, 1, 0.1),
            (5, 4, 0.3),
            (6, 1, 1.0),
            (7, 3, 1.0),
            (8, 6, 1.0),
        ]
    else:
        chosen = [(4, 0, 0.2), (5, 4, 1.0)]
    return [random_episode(env, drawn(env, k, stratum), rng, scale) for k, stratum, scale in chosen]


def check_episode(env: gym.Env, episode: RandomEpisode) -> None:
    robot = env.unwrapped.world.scene.robot
    for (observation, reward, done, truncated, info), state in zip(episode.results, episode.states, strict=True):
        assert observation in env.observation_space
        assert np.isfinite(observation).all()
        assert type(reward) is float
        assert type(done) is bool
        assert truncated is False
        assert done or info["is_success"] is False
        too_fast = bool((np.abs(state.dq) > robot.stop_speed * robot.dq_max).any())
        assert done or not too_fast
        assert math.isfinite(sum(body.pose.position.sum() for body in state.objects.values()))
    check_end(env, [result[1] for result in episode.results], episode.results[-1][4], episode.condition)


def check_end(env: gym.Env, rewards: list[float], info: dict[str, Any], condition: Condition) -> None:
    assert not any(rewards[:-1])
    assert type(info["is_success"]) is bool
    assert info["condition_id"] == condition.id
    assert info["difficulty"] == condition.difficulty
    assert bool(info["failure"]) != info["is_success"]
    if not isinstance(env.unwrapped, ResidualEnv):
        assert set(info) >= TASK_INFO
        assert rewards[-1] == float(info["is_success"])
        return
    task = env.unwrapped.task
    assert set(info) == RESIDUAL_INFO
    assert type(info["checkpoint"]) is int
    assert info["phase"] in {phase.name for phase in task.phases}
    assert (info["checkpoint"] == task.n_checkpoints) == info["is_success"]
    expected = 1.0 if info["is_success"] else info["checkpoint"] / task.n_checkpoints
    assert rewards[-1] == expected
    assert (rewards[-1] == 1.0) == info["is_success"]


def test_gymnasium_accepts_it(env: gym.Env) -> None:
    with warnings.catch_warnings():
        # Absolute targets have units and privileged state has no bounds; residual envs get no such leave.
        if not isinstance(env.unwrapped, ResidualEnv):
            warnings.simplefilter("ignore", UserWarning)
        check_env(env.unwrapped, skip_render_check=True)


def test_stable_baselines_accepts_it(env: gym.Env) -> None:
    sb3_check_env(env.unwrapped, warn=isinstance(env.unwrapped, ResidualEnv), skip_render_check=True)


def test_random_episodes_are_finite_and_end_as_agreed(env: gym.Env, episodes: list[RandomEpisode]) -> None:
    for episode in episodes:
        check_episode(env, episode)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_hundred_random_episodes_are_finite_and_end_as_agreed(env: gym.Env) -> None:
    rng = np.random.default_rng(1)
    for k in range(200):
        check_episode(env, random_episode(env, drawn(env, k, k % 8), rng))


def test_the_sizes_of_the_layout_add_up(env: gym.Env) -> None:
    inner = env.unwrapped
    layout = inner.observer.layout if isinstance(inner, ResidualEnv) else inner.layout
    assert sum(part[1] for part in layout) == env.observation_space.shape[0]
    assert len({part[0] for part in layout}) == len(layout)


def test_every_element_of_the_observation_carries_something(env: gym.Env, episodes: list[RandomEpisode]) -> None:
    inner = env.unwrapped
    layout = inner.observer.layout if isinstance(inner, ResidualEnv) else inner.layout
    names = [(name, i) for name, size, *_ in layout for i in range(size)]
    spreads = np.ptp([result[0] for episode in episodes for result in episode.results], axis=0)
    constant = {name for name, spread in zip(names, spreads, strict=True) if spread == 0}
    if isinstance(inner, ResidualEnv):
        # Under "skip" a decision never starts in a phase without a gate.
        skipped = [i for i, phase in enumerate(inner.task.phases) if not phase.gate]
        known = {("phase", i) for i in skipped if inner.gate_mode == "skip"}
        if not any(phase.track_until and phase.gate for phase in inner.task.phases):
            known.add(("frozen", 0))
        if inner.gate_mode == "skip" and inner.task.phases[-1].gate:
            known.add(("gate", 0))
        if len({phase.width for phase in inner.task.phases}) == 1:
            known.add(("plan_width", 0))
    else:
        known = {(f"{name}/touching", i) for name in inner.task.scene.tracked for i in range(2)}
    assert constant <= known | still_in_fixtures(inner.task)


def still_in_fixtures(task: Task) -> set[tuple[str, int]]:
    """Name what a fixture that moves on the plane or turns about the vertical never changes."""
    names = {fixture.name for fixture in task.scene.fixtures}
    planar = (
        ("position", 2),
        ("quat_wxyz", 1),
        ("quat_wxyz", 2),
        ("velocity", 2),
        ("axis", 0),
        ("axis", 1),
        ("axis", 2),
    )
    turning = (("angular_velocity", 0), ("angular_velocity", 1), ("angular_velocity", 2))
    known = {(f"{name}/{part}", i) for name in names for part, i in (*planar, *turning)}
    if names & {phase.target.object for phase in task.phases}:
        known |= {
            (part, 2) for part in ("object_position", *(f"object_velocity[{-k}]" for k in range(task.residual.history)))
        }
        known |= {("object_angular_velocity", i) for i in range(3)}
    return known


def test_the_same_seed_draws_the_same_conditions(env: gym.Env) -> None:
    first = [env.reset(seed=4)[1]["condition_id"], *(env.reset()[1]["condition_id"] for _ in range(2))]
    again = [env.reset(seed=4)[1]["condition_id"], *(env.reset()[1]["condition_id"] for _ in range(2))]
    assert first == again
    assert len(set(first)) == 3


def test_a_condition_may_come_as_its_dict(env: gym.Env) -> None:
    condition = drawn(env, 1)
    one, _ = env.reset(options={"condition": condition})
    other, info = env.reset(options={"condition": condition.to_dict()})
    np.testing.assert_array_equal(one, other)
    assert info["condition_id"] == condition.id


def test_the_sampler_draws_what_reset_takes(env: gym.Env) -> None:
    sampler = env.unwrapped.condition_sampler
    condition = sampler.draw(np.random.default_rng(0))
    assert env.reset(**sampler.reset_kwargs(condition))[1]["condition_id"] == condition.id


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"conditoin": 1}, r"Unknown reset options \['conditoin'\]; the one known is 'condition'"),
        ({"condition": "fast"}, "must be a Condition or its dict, got str"),
        ({"condition": {"task": "can", "seed": 1}}, r"lacks \['difficulty', 'values'\]"),
        ({"condition": Condition("zebra", 1, 0.5, {})}, "belongs to task 'zebra'"),
    ],
)
def test_wrong_reset_options_are_named(env: gym.Env, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        env.reset(options=options)
    assert "\n" not in str(caught.value)


def test_wrong_actions_are_named_and_change_nothing(env: gym.Env) -> None:
    inner = env.unwrapped
    inner.reset(options={"condition": drawn(env, 1)})
    before = inner.world.state
    size = env.action_space.shape[0]
    for bad in (np.full(size, np.nan), np.full(size, np.inf), np.zeros(size + 1), np.zeros((1, size)), np.float32(0)):
        with pytest.raises(ValueError, match=rf"Action must be \({size},\) finite numbers"):
            inner.step(bad.astype(np.float32))
    assert inner.world.state is before


@pytest.mark.parametrize(("name", "kwargs"), VARIANTS, ids=NAMES)
def test_a_new_env_refuses_to_step_and_closes_twice(name: str, kwargs: dict[str, str]) -> None:
    env = gym.make(name, **kwargs).unwrapped
    with pytest.raises(RuntimeError, match=r"call env.reset\(\) first"):
        env.step(env.action_space.sample())
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
    env.close()
    for call in (env.reset, env.render, lambda: env.step(env.action_space.sample())):
        with pytest.raises(RuntimeError, match="This env is closed; make a new one"):
            call()


@pytest.mark.parametrize("name", [f"DynaForge/{name}-v0" for name in ENV_NAMES.values()] + ["DynaForge/CanTask-v0"])
def test_an_env_draws_itself(name: str) -> None:
    env = gym.make(name, render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (360, 480, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10, "not a blank picture"
    for _ in range(6):
        env.unwrapped.step(env.action_space.sample())
    assert (env.render() != picture).any()
    env.close()


def test_an_env_without_pictures_draws_none() -> None:
    env = ResidualEnv()
    assert env.render() is None
    env.close()
