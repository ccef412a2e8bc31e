from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trajectory_hash import TrajectoryHash, condition

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.task_env import TaskEnv
from dynaforge.geometry import rotvec_from_matrix
from dynaforge.tasks import ConditionSpace
from dynaforge.tasks.targets import DOWN_ALONG_X

EASY = min((condition(0, seed) for seed in range(40)), key=lambda c: c.difficulty)  # planner only lifts it


def planner_steps():
    """Record the planner only on an easy condition."""
    env = ResidualEnv("can")
    trace = TrajectoryHash(env.world)
    env.reset(options={"condition": EASY})
    done, info = False, {}
    while not done:
        _, _, done, _, info = env.step(np.zeros(5, np.float32))
    env.close()
    assert info["is_success"]
    return trace.steps


@pytest.fixture(scope="module")
def recorded():
    return planner_steps()


def play(env: TaskEnv, actions: list[np.ndarray]):
    env.reset(options={"condition": EASY})
    for k, chosen in enumerate(actions):
        observation, reward, done, truncated, info = env.step(chosen)
        assert not truncated
        if done:
            return k + 1, observation, reward, info
    return None


def test_joint_references_of_a_success_succeed_again(recorded) -> None:
    env = TaskEnv("can", action_mode="joint")
    actions = [np.float32((*step.reference.joints.q, step.reference.width)) for step in recorded]
    steps, _, reward, info = play(env, [*actions, *[actions[-1]] * 10])
    assert reward == 1.0
    assert info == {
        "is_success": True,
        "failure": "",
        "condition_id": EASY.id,
        "difficulty": EASY.difficulty,
    }
    assert abs(steps - len(recorded)) <= 10
    env.close()


def test_end_effector_targets_of_a_success_succeed_again(recorded) -> None:
    env = TaskEnv("can", action_mode="ee")
    actions = [
        np.float32((*wanted.pose.position, *rotvec_from_matrix(wanted.pose.rotation @ DOWN_ALONG_X.T), wanted.width))
        for wanted in (step.requested for step in recorded)
    ]
    result = play(env, [*actions, *[actions[-1]] * 30])
    assert result is not None
    assert result[2] == 1.0
    env.close()


def test_the_observation_is_the_measured_state_in_the_order_of_the_layout() -> None:
    env = TaskEnv("can")
    observation, info = env.reset(options={"condition": EASY})
    assert info == {"condition_id": EASY.id}
    parts = dict(
        zip((n for n, _ in env.layout), np.split(observation, np.cumsum([s for _, s in env.layout])[:-1]), strict=True)
    )
    state = env.world.state
    body = state.objects["can"]
    np.testing.assert_array_equal(parts["q"], state.q)
    np.testing.assert_array_equal(parts["ee_position"], state.ee.position)
    np.testing.assert_array_equal(parts["can/position"], body.pose.position)
    np.testing.assert_array_equal(parts["can/velocity"], body.velocity)
    np.testing.assert_array_equal(parts["can/angular_velocity"], body.angular_velocity)
    assert parts["time_left"] == 1.0
    env.close()


def test_a_straight_down_target_is_the_zero_rotation_vector() -> None:
    env = TaskEnv("can")
    env.reset(options={"condition": EASY})
    for _ in range(90):
        env.step(np.float32((0.4, 0.1, 0.3, 0.0, 0.0, 0.0, 0.04)))
    np.testing.assert_allclose(env.world.state.ee.position, (0.4, 0.1, 0.3), atol=3e-3)
    np.testing.assert_allclose(env.world.state.ee.rotation, DOWN_ALONG_X, atol=0.02)
    assert env.world.state.width == pytest.approx(0.04, abs=2e-3)
    env.close()


def test_doing_nothing_ends_in_a_named_failure() -> None:
    env = TaskEnv("can", action_mode="joint")
    env.reset(options={"condition": EASY})
    stay = np.float32((*env.world.scene.robot.q_ready, 0.08))
    for steps in range(1, 400):  # noqa: B007
        _, reward, done, truncated, info = env.step(stay)
        if done:
            break
    assert (reward, truncated) == (0.0, False)
    assert info["failure"] in ("timeout", "lost track")
    assert steps <= round(env.task.time_limit * 30)
    env.close()


def test_a_wrong_action_mode_is_named() -> None:
    with pytest.raises(ValueError, match="action_mode is 'joints'; it must be one of 'ee', 'joint'"):
        TaskEnv("can", action_mode="joints")


@pytest.mark.parametrize("rotation", ["quat_wxyz", "rotation_6d"])
def test_corners_of_the_action_space_that_mean_no_rotation_leave_the_hand_its_own(rotation: str) -> None:
    env = TaskEnv("can", rotation=rotation, elbow=True)
    env.reset(options={"condition": EASY})
    start = env.world.state
    n = len(env.action_space.low)
    for _ in range(5):
        env.step(np.float32((*start.ee.position, *np.zeros(n - 5), 0.08, start.q[2])))
    np.testing.assert_allclose(env.world.state.ee.rotation, start.ee.rotation, atol=5e-3)
    for corner in (env.action_space.low, env.action_space.high):
        env.step(corner)
    env.close()


@pytest.mark.parametrize("kind", [ResidualEnv, TaskEnv])
def test_a_condition_is_checked_once_a_reset(kind, monkeypatch: pytest.MonkeyPatch) -> None:
    checked = []
    validate = ConditionSpace.validate
    monkeypatch.setattr(ConditionSpace, "validate", lambda space, c: checked.append(c) or validate(space, c))
    env = kind("can")
    env.reset(options={"condition": EASY})
    assert checked == [EASY]
    env.reset(seed=0)
    assert len(checked) == 2
    env.close()


@pytest.mark.parametrize("kind", [ResidualEnv, TaskEnv])
def test_a_reset_that_is_refused_leaves_the_episode_as_it_is(kind) -> None:
    env = kind("can")
    env.reset(options={"condition": EASY})
    before = env.world.state
    with pytest.raises(ValueError, match="belongs to task 'peach'"):
        env.reset(options={"condition": replace(EASY, task="peach")})
    assert env.world.state is before
    env.step(np.zeros(env.action_space.shape, np.float32))
    assert env.world.state.time > before.time
    env.close()
