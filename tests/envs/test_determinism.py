"""Same condition, same actions: one trajectory, whatever happened before and wherever it runs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from trajectory_hash import Traced, action, condition, lifted, run, traced_env

from dynaforge.envs.task_env import TaskEnv
from dynaforge.sampling.vector_env import SharedMemoryVecEnv
from dynaforge.sim import Condition


@cache
def conditions() -> list[Condition]:
    """Return one condition whose can is lifted and one that is too fast."""
    return [lifted(), condition(6)]


IN_ANOTHER_PROCESS = """
import sys
sys.path.insert(0, sys.argv[1])
from trajectory_hash import condition, lifted, run, traced_env
env = traced_env()
print(*(run(env, c)[0] for c in (lifted(), condition(6))))
"""


@pytest.fixture(scope="module")
def fresh() -> list[str]:
    """The digests of both conditions, each in an env of its own that did nothing before."""
    digests = []
    for which in conditions():
        env = traced_env()
        digest, info = run(env, which)
        assert info["is_success"] is (which is conditions()[0])
        digests.append(digest)
        env.close()
    assert digests[0] != digests[1]
    return digests


def after_itself(env: Traced) -> None:
    run(env, conditions()[0])


def after_other_conditions(env: Traced) -> None:
    for stratum in (0, 7, 4):
        run(env, condition(stratum, 5), scale=-1.0)


def after_an_episode_left_in_mid_grasp(env: Traced) -> None:
    env.reset(options={"condition": conditions()[0]})
    state = env.unwrapped.world
    for k in range(100):
        env.step(action(k))
        if all(state.state.touching["can"]):
            return
    raise AssertionError("the can was never grasped")


def after_a_refused_action(env: Traced) -> None:
    env.reset(options={"condition": conditions()[1]})
    env.step(action(0))
    with pytest.raises(ValueError, match="finite"):
        env.step(np.full(5, np.nan, np.float32))


def after_another_env_in_the_process(env: Traced) -> None:
    other = TaskEnv("can", action_mode="joint")
    other.reset(options={"condition": conditions()[1]})
    low, high = other.action_space.low, other.action_space.high
    for k in range(40):
        other.step(low + (high - low) * np.float32(0.5 + 0.5 * np.sin(k)))
    other.close()
    env.reset(seed=1)


def after_leaning_on_the_table(env: Traced) -> None:
    env.reset(options={"condition": condition(0, 3)})
    world = env.unwrapped.world
    press = world.scene.robot.q_ready + np.array((0.2, 0.6, 0.0, -0.2, 0.0, 0.0, 0.0))
    for _ in range(40):
        world.reach_joints(press, 0.0)


HISTORIES = [
    after_itself,
    after_other_conditions,
    after_an_episode_left_in_mid_grasp,
    after_a_refused_action,
    after_another_env_in_the_process,
    after_leaning_on_the_table,
]


@pytest.mark.parametrize("history", HISTORIES)
def test_the_history_of_an_env_leaves_no_trace(history: Callable[[Traced], None], fresh: list[str]) -> None:
    env = traced_env()
    for which, digest in zip(conditions(), fresh, strict=True):
        history(env)
        assert run(env, which)[0] == digest
    env.close()


def test_drawing_pictures_changes_nothing(fresh: list[str]) -> None:
    env = traced_env(render_mode="rgb_array")
    env.reset(options={"condition": conditions()[1]})
    env.render()
    assert [run(env, which)[0] for which in conditions()] == fresh
    env.close()


def test_other_actions_give_another_trajectory(fresh: list[str]) -> None:
    env = traced_env()
    assert run(env, conditions()[0], scale=0.99)[0] != fresh[0]
    env.close()


def test_another_process_gives_the_same_bits(fresh: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", IN_ANOTHER_PROCESS, str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.split()[-2:] == fresh


def vectorised_digests(envs: VecEnv) -> list[str]:
    """Run one episode per env, both conditions in turn; envs that end early continue with one that is ignored."""
    n = envs.num_envs
    digests: dict[int, str] = {}
    envs.set_options([{"condition": conditions()[index % 2]} for index in range(n)])
    envs.reset()
    k = 0
    while len(digests) < n:
        _, _, dones, infos = envs.step(np.tile(action(k), (n, 1)))
        for index in np.flatnonzero(dones):
            digests.setdefault(int(index), infos[index]["trajectory"])
        k += 1
    envs.close()
    return [digests[index] for index in range(n)]


@pytest.mark.parametrize("n_envs", [1, 4, pytest.param(16, marks=pytest.mark.slow)])
def test_any_number_of_envs_in_this_process_gives_the_same_bits(n_envs: int, fresh: list[str]) -> None:
    envs = DummyVecEnv([traced_env] * n_envs)
    assert vectorised_digests(envs) == (fresh * n_envs)[:n_envs]


@pytest.mark.parametrize(
    "n_envs", [pytest.param(1, marks=pytest.mark.slow), 4, pytest.param(16, marks=pytest.mark.slow)]
)
def test_any_number_of_envs_in_workers_gives_the_same_bits(n_envs: int, fresh: list[str]) -> None:
    envs = SharedMemoryVecEnv([partial(traced_env)] * n_envs, n_workers=2)
    assert vectorised_digests(envs) == (fresh * n_envs)[:n_envs]
