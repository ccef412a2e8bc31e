"""The part of an episode before its first gate, simulated once for all rollouts of a condition."""

from __future__ import annotations

import gc
import weakref
from collections import deque
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv
from trajectory_hash import TrajectoryHash

from dynaforge.algos import FrontierGRPO
from dynaforge.envs.residual_env import GateMode, ResidualEnv
from dynaforge.sampling.vector_env import SharedMemoryVecEnv
from dynaforge.tasks import TASK_NAMES


def episode(env: ResidualEnv, condition: Any, rollout: int, *, most: int = 10_000) -> list[bytes]:
    """Run an episode, or its first steps, with random actions.

    Returns:
        All that it answers, bit for bit, then a hash of all physics from the first gate on, then the loads.
    """
    rng = np.random.default_rng(rollout)
    observation, _ = env.reset(options={"condition": condition})
    answers, done, trace = [observation.tobytes()], False, None
    while not done and len(answers) <= most:
        if trace is None and not env._untold and env.executor.action.gate:
            trace = TrajectoryHash(env.world)
        action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        observation, reward, done, _, info = env.step(action)
        answers.append(observation.tobytes() + str((reward, sorted(map(str, info.items())))).encode())
    assert trace is not None, "no gate opened"
    env.world.listeners.remove(trace)
    return [*answers, trace.hex.encode(), str(env.world.scene.loads).encode()]


def test_an_env_that_is_dropped_frees_its_world_at_once() -> None:
    env = ResidualEnv("can")
    episode(env, env.task.conditions.draw(np.random.default_rng(0)), 0, most=12)
    world = weakref.ref(env.world.scene)
    gc.disable()
    try:
        del env
        assert world() is None
    finally:
        gc.enable()


# What is saved, when it is saved, and memory that is written before it is read.
LEFT_OUT = {
    "_saved_later",
    "_saved",
    "_first_gate",
    "_memory",
    "_own",
    "_prefix",
    "_fresh",
    "_gate_opened",
    "_gram",
    "_gram_diagonal",
}


def everything(part: Any, path: str, seen: set[int]) -> Iterator[tuple[str, Any]]:
    """Yield all numbers and arrays that an object of the package is made of, by where they are."""
    if id(part) in seen:
        return
    if isinstance(part, (str, bytes, bool, int, float, type(None))):
        yield path, part
    elif isinstance(part, np.ndarray):
        yield path, (part.shape, part.tobytes())
    elif isinstance(part, (list, tuple, deque)):
        for k, item in enumerate(part):
            yield from everything(item, f"{path}[{k}]", seen)
    elif isinstance(part, dict):
        for name, item in part.items():
            yield from everything(item, f"{path}[{name!r}]", seen)
    elif type(part).__module__.startswith("dynaforge"):
        seen.add(id(part))
        slots = [name for kind in type(part).__mro__ for name in getattr(kind, "__slots__", ())]
        for name in (*getattr(part, "__dict__", {}), *slots):
            if name not in LEFT_OUT and hasattr(part, name):
                yield from everything(getattr(part, name), f"{path}.{name}", seen)


def compare(task: str, mode: GateMode, *, rollouts: int, most: int) -> None:
    """Assert that the episodes of a condition are the same with and without sharing, and that only the first saves."""
    shared, alone = ResidualEnv(task, gate_mode=mode), ResidualEnv(task, gate_mode=mode, share_prefix=False)
    condition = shared.task.conditions.draw(np.random.default_rng(2))
    for rollout in range(rollouts):
        before = shared.world.scene.saved
        assert episode(shared, condition, rollout, most=most) == episode(alone, condition, rollout, most=most), task
        assert (shared.world.scene.saved is before) is (rollout > 0), "the prefix was not shared"
    assert alone.world.scene.saved is None
    shared.close()
    alone.close()


def test_sharing_changes_no_bit() -> None:
    for name in TASK_NAMES:  # one test, since what each of them costs is the loading of its scenes
        compare(name, "skip", rollouts=2, most=8)


@pytest.mark.parametrize("task", ["can", "peg"])
def test_steps_answered_from_memory_are_those_that_would_be_simulated(task: str) -> None:
    compare(task, "mask", rollouts=3, most=60)


@pytest.mark.parametrize("task", ["can", "peg"])
def test_nothing_that_changes_in_an_episode_is_forgotten(task: str) -> None:
    env = ResidualEnv(task)
    condition = env.task.conditions.draw(np.random.default_rng(3))
    env.reset(options={"condition": condition})
    first = dict(everything(env, "env", set()))
    changed = set()
    for rollout in range(2):
        episode(env, condition, rollout)
        end = dict(everything(env, "env", set()))
        changed |= {path for path in first if first[path] != end.get(path)}
        env.reset(options={"condition": condition})
        again = dict(everything(env, "env", set()))
        assert [path for path in first if first[path] != again.get(path)] == []
    assert any("_history" in path for path in changed)
    assert any("_arm" in path for path in changed)
    env.close()


def test_a_condition_of_which_nothing_is_saved_is_simulated_from_its_start() -> None:
    env, fresh = ResidualEnv("can"), ResidualEnv("can")
    one, other = (env.task.conditions.draw(np.random.default_rng(seed)) for seed in (1, 2))
    expected = [episode(fresh, other, 5)]
    for before in (lambda: episode(env, one, 0), lambda: env.world.reset(other), lambda: env.world.scene.save()):
        before()
        expected.append(episode(env, other, 5))
    assert len({tuple(each) for each in expected}) == 1
    env.close()
    fresh.close()


def test_at_most_one_world_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    env = ResidualEnv("can")
    client, kept = env.world.scene._bullet.client, set()
    save, remove = client.saveState, client.removeState

    def saved() -> int:
        kept.add(state := save())
        return state

    def removed(state: int) -> None:
        kept.remove(state)
        remove(state)

    monkeypatch.setattr(client, "saveState", saved, raising=False)
    monkeypatch.setattr(client, "removeState", removed, raising=False)
    for seed in (0, 0, 1, 2):
        episode(env, env.task.conditions.draw(np.random.default_rng(seed)), 0, most=1)
        assert len(kept) == 1
    env.close()


def test_whoever_begins_to_listen_before_the_gate_hears_all_that_follows() -> None:
    env, alone = ResidualEnv("can", gate_mode="mask"), ResidualEnv("can", gate_mode="mask", share_prefix=False)
    condition = env.task.conditions.draw(np.random.default_rng(1))
    episode(env, condition, 0, most=30)
    times = []
    for each in (env, alone):
        each.reset(options={"condition": condition})
        idle = np.zeros(each.action_space.shape, np.float32)
        each.step(idle)
        with each.world.listening((steps := []).append):
            each.step(idle)
        times.append([(step.before.time, step.after.q.tobytes()) for step in steps])
        each.close()
    assert times[0] == times[1]
    assert times[0]


def test_whoever_listens_hears_whole_episodes() -> None:
    env = ResidualEnv("can")
    condition = env.task.conditions.draw(np.random.default_rng(1))
    episode(env, condition, 0)
    with env.world.listening((steps := []).append):
        env.reset(options={"condition": condition})
    assert steps
    assert steps[0].before.time == 0.0
    env.close()


def trained(*, share_prefix: bool, updates: int, n_workers: int | None = None, **options: int) -> list[bytes]:
    """Train on Can; return all observations of the last update and the parameters, bit for bit."""
    make = [partial(ResidualEnv, "can", gate_mode="mask", share_prefix=share_prefix)] * 2
    env = DummyVecEnv(make) if n_workers is None else SharedMemoryVecEnv(make, n_workers=n_workers)
    model = FrontierGRPO("MlpPolicy", env, seed=0, device="cpu", group_filter="none", batch_size=16, **options)
    for _ in range(updates):
        model.learn(1, reset_num_timesteps=False)
    env.close()
    parameters = [each.detach().numpy().tobytes() for each in model.policy.parameters()]
    return [model.rollout_buffer.observations.tobytes(), *parameters]


def test_training_that_shares_and_training_that_does_not_give_the_same_bits() -> None:
    sizes = {"updates": 1, "n_groups": 2, "group_size": 2, "n_epochs": 1}
    assert trained(share_prefix=True, **sizes) == trained(share_prefix=False, **sizes)


@pytest.mark.slow
def test_longer_training_in_workers_gives_the_same_bits_too() -> None:
    sizes = {"updates": 3, "n_groups": 4, "group_size": 4, "n_epochs": 2}
    assert trained(share_prefix=True, n_workers=2, **sizes) == trained(share_prefix=False, **sizes)
