from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv
from toy_envs import MatchEnv

from dynaforge.algos.decision_replay import DecisionReplay
from dynaforge.algos.plain_mlp import plain_mlp, squashes_mean
from dynaforge.algos.residual_sac import ResidualSAC
from dynaforge.training.checkpoint import load_checkpoint, save_checkpoint

BOX = spaces.Box(-1.0, 1.0, (1,), np.float32)


def model(n_envs: int = 4, **options) -> ResidualSAC:
    defaults = {
        "seed": 0,
        "learning_starts": 60,
        "update_ratio": 1,
        "batch_size": 32,
        "policy_kwargs": {"net_arch": [16]},
    }
    return ResidualSAC("MlpPolicy", DummyVecEnv([MatchEnv] * n_envs), device="cpu", **(defaults | options))


def replay(n_envs: int = 1, size: int = 20) -> DecisionReplay:
    return DecisionReplay(size, BOX, BOX, n_envs=n_envs, seed=0)


def add_episode(buffer: DecisionReplay, actions: list[float], *, success: bool, masks: tuple[float, ...] = ()) -> None:
    """Add an episode of one env whose observations count its steps, with a reward of 0.25 for each step."""
    for k, (action, mask) in enumerate(zip(actions, masks or [1.0] * len(actions), strict=True)):
        done = k == len(actions) - 1
        info = {"residual_mask": mask, "is_success": success and done}
        rows = ([[k / 10]], [[(k + 1) / 10]], [[action]], [0.25], [done])
        buffer.add(*(np.array(row, np.float32) for row in rows), [info])


def test_successes_of_the_planner_alone_have_a_buffer_of_their_own() -> None:
    buffer = replay()
    add_episode(buffer, [0.0, 0.0], success=True)
    add_episode(buffer, [0.0, 0.0, 0.0], success=False)
    add_episode(buffer, [0.0, 0.5], success=True)
    assert (buffer.planner.size(), buffer.size()) == (2, 5)


def test_half_of_a_batch_is_from_the_planner_and_all_of_it_where_there_is_no_other() -> None:
    buffer = replay()
    with pytest.raises(ValueError, match="no episode with a decision has ended"):
        buffer.sample(10)
    add_episode(buffer, [0.0], success=True)
    assert (buffer.sample(10).actions == 0.0).all()
    for _ in range(9):
        add_episode(buffer, [0.5], success=True)
    assert (buffer.sample(100).actions == 0.0).sum() == 50
    other = replay()
    add_episode(other, [0.5], success=True)
    assert (other.sample(10).actions == 0.5).all()


def test_steps_without_a_decision_prolong_the_one_before_them() -> None:
    buffer = replay()
    add_episode(buffer, [0.9, 0.1, 0.9, 0.2, 0.9], success=True, masks=(0.0, 1.0, 0.0, 1.0, 0.0))
    add_episode(buffer, [0.9], success=False, masks=(0.0,))
    assert buffer.size() == 2
    np.testing.assert_allclose(buffer.actions[:2, 0, 0], [0.1, 0.2])
    np.testing.assert_allclose(buffer.observations[:2, 0, 0], [0.1, 0.3])
    np.testing.assert_allclose(buffer.next_observations[:2, 0, 0], [0.3, 0.5])
    np.testing.assert_allclose(buffer.rewards[:2, 0], [0.5, 0.5])
    np.testing.assert_allclose(buffer.dones[:2, 0], [0.0, 1.0])


def test_buffers_are_restored_with_the_oldest_decision_first() -> None:
    first, second = replay(size=4), replay(size=4)
    for action in (0.1, 0.2, 0.3, 0.4, 0.5):
        add_episode(first, [action], success=False)
    add_episode(first, [0.0], success=True)
    second.restore(first.state())
    np.testing.assert_allclose(second.actions[:, 0, 0], [0.2, 0.3, 0.4, 0.5])
    add_episode(second, [0.6], success=False)
    assert second.actions[0, 0, 0] == np.float32(0.6), "the oldest goes first"
    assert (second.size(), second.planner.size()) == (4, 1)
    with pytest.raises(ValueError, match=r"online\.observations has shape \(4, 1, 1\), expected at most \(2, 1, 1\)"):
        replay(size=2).restore(first.state())


def test_training_begins_with_the_planner_and_its_steps_count() -> None:
    sac = model().learn(60)
    buffer = sac.replay_buffer
    assert sac.num_timesteps == 60
    assert not buffer.actions.any()
    assert buffer.decisions == 40, "two of three steps of an episode are decisions"
    assert 0 < buffer.planner.size() < 40
    assert sac._n_updates == 0
    sac.learn(8, reset_num_timesteps=False)
    assert sac._n_updates == 8, "one gradient step for each environment step"


def test_an_untrained_actor_is_the_planner_with_a_small_noise() -> None:
    sac, observations = model(), np.random.default_rng(0).uniform(-1, 1, (200, 3)).astype(np.float32)
    assert not sac.predict(observations, deterministic=True)[0].any()
    assert sac.predict(observations)[0].std() == pytest.approx(np.exp(-1.8), rel=0.2)


def test_critics_have_a_layer_norm_and_are_what_is_trained() -> None:
    sac = model()
    for critic in (sac.critic, sac.critic_target):
        for k, network in enumerate(critic.q_networks):
            assert [type(layer).__name__ for layer in network] == ["Linear", "LayerNorm", "ReLU", "Linear"]
            assert getattr(critic, f"qf{k}") is network
    trained = {id(p) for group in sac.critic.optimizer.param_groups for p in group["params"]}
    assert trained == {id(p) for p in sac.critic.parameters()}


def test_the_policy_file_of_an_actor_is_its_squashed_mean() -> None:
    sac = model()
    with th.no_grad():
        sac.actor.mu.weight.normal_(generator=th.Generator().manual_seed(1))
    layers, activation = plain_mlp(sac)
    assert squashes_mean(sac)
    assert activation == "ReLU"
    observation = np.array([0.3, 0.5, 0.1], np.float32)
    (w0, b0), (w1, b1) = layers
    mean = np.tanh(w1 @ np.maximum(w0 @ observation + b0, 0.0) + b1)
    np.testing.assert_allclose(sac.predict(observation, deterministic=True)[0], mean, atol=1e-6)


def test_an_update_ratio_below_one_is_refused() -> None:
    with pytest.raises(ValueError, match="update_ratio is 0, but must be at least 1"):
        model(update_ratio=0)


def test_a_checkpoint_contains_all_that_a_gradient_step_depends_on(tmp_path: Path) -> None:
    path = tmp_path / "c"
    trained = model().learn(100)
    save_checkpoint(trained, path)
    resumed = [model(policy_kwargs={"net_arch": [16], "log_std_init": -3.0}) for _ in range(2)]
    for each in resumed:
        load_checkpoint(each, path, seed=0)
        assert each.num_timesteps == 100
        assert each._n_updates == trained._n_updates > 0
        for name, rows in trained.replay_buffer.state().items():
            np.testing.assert_array_equal(rows, each.replay_buffer.state()[name])
    # Once the draws are the same, so is the next step: weights, targets, moments and temperature are.
    for each in (trained, *resumed):
        each.set_logger(configure(None, []))
        each.replay_buffer.rng = np.random.default_rng(7)
        th.manual_seed(7)
        each.train(3, 16)
    for each in resumed:
        for mine, theirs in zip(trained.policy.state_dict().values(), each.policy.state_dict().values(), strict=True):
            assert th.equal(mine, theirs)
        assert th.equal(trained.log_ent_coef, each.log_ent_coef)


def test_a_resumed_training_does_not_depend_on_what_came_before_the_checkpoint(tmp_path: Path) -> None:
    save_checkpoint(model().learn(100), tmp_path / "c")
    ends = []
    for seed in (0, 1):
        each = model(seed=seed)
        load_checkpoint(each, tmp_path / "c", seed=0)
        each.learn(40, reset_num_timesteps=False)
        assert each.num_timesteps == 140
        ends.append(th.nn.utils.parameters_to_vector(each.policy.parameters()))
    assert th.equal(*ends)


def test_sb3_saves_and_loads_it(tmp_path: Path) -> None:
    trained = model().learn(80)
    trained.save(tmp_path / "m")
    loaded = ResidualSAC.load(tmp_path / "m", env=DummyVecEnv([MatchEnv] * 4), device="cpu")
    observations = np.random.default_rng(0).uniform(-1, 1, (5, 3)).astype(np.float32)
    actions = [each.predict(observations, deterministic=True)[0] for each in (trained, loaded)]
    np.testing.assert_array_equal(*actions)
    assert (loaded.update_ratio, loaded.gradient_steps) == (1, 4)
    loaded.learn(20, reset_num_timesteps=False)


@pytest.mark.slow
def test_it_learns_a_toy_far_beyond_the_planner() -> None:
    def success(sac: ResidualSAC) -> float:
        env, won = MatchEnv(), 0
        for k in range(200):
            observation, _ = env.reset(seed=1000 + k)
            done, info = False, {}
            while not done:
                observation, _, done, _, info = env.step(sac.predict(observation, deterministic=True)[0])
            won += info["is_success"]
        return won / 200

    sac = model(8, learning_starts=160, update_ratio=1, learning_rate=3e-3, batch_size=64)
    before = success(sac)
    assert success(sac.learn(800)) > max(0.9, before + 0.2)
