"""A condition fixes the episode, for every task: over histories and processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from trajectory_hash import Traced, run

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.tasks import TASK_NAMES, get_task

IN_ANOTHER_PROCESS = """
import sys
sys.path.insert(0, sys.argv[1])
from test_every_task import TASK_NAMES, chosen, fresh
print(*(fresh(name) for name in TASK_NAMES))
"""


def chosen(name: str, k: int = 0):
    """Return a condition of a task: one that is easy for the planner, so that the hand meets the object."""
    stream = get_task(name).conditions.stream("val", n_strata=8)
    return [next(stream) for _ in range(8 * (k + 1))][8 * k + k % 8]


def fresh(name: str) -> str:
    env = Traced(ResidualEnv(name))
    digest = run(env, chosen(name), scale=0.1)[0]
    env.close()
    return digest


@pytest.fixture(scope="module")
def elsewhere() -> dict[str, str]:
    """The digest of one episode of every task, made in another process."""
    done = subprocess.run(
        [sys.executable, "-c", IN_ANOTHER_PROCESS, str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
    )
    return dict(zip(TASK_NAMES, done.stdout.split(), strict=True))


def left_in_the_middle(env: Traced, name: str, seed: int) -> None:
    """Begin an episode of another condition with random actions: a history that the next one must not show."""
    env.action_space.seed(seed)
    env.reset(options={"condition": chosen(name, 1 + seed % 3)})
    for _ in range(5):
        if env.step(env.action_space.sample())[2]:
            break


@pytest.mark.parametrize("name", TASK_NAMES)
def test_one_condition_gives_one_trajectory(name: str, elsewhere: dict[str, str]) -> None:
    env = Traced(ResidualEnv(name))
    first = run(env, chosen(name), scale=0.1)[0]
    run(env, chosen(name, 3), scale=0.8)
    for seed in (7, 19, 42):  # a hundred such histories in the slow test below
        left_in_the_middle(env, name, seed)
        assert run(env, chosen(name), scale=0.1)[0] == first == elsewhere[name]
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", TASK_NAMES)
def test_no_history_shows(name: str) -> None:
    env = Traced(ResidualEnv(name))
    first = run(env, chosen(name), scale=0.1)[0]
    for seed in range(100):
        left_in_the_middle(env, name, seed)
        assert run(env, chosen(name), scale=0.1)[0] == first, seed
    env.close()
