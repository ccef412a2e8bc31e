"""Lifecycle of FrontierGRPO: what any SB3 algorithm must do, and what whole-episode sampling adds."""

from __future__ import annotations

import base64
import json
import os
import zipfile
from functools import partial
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback, StopTrainingOnMaxEpisodes
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from toy_envs import EndlessEnv, MatchEnv, TargetSampler

from dynaforge.algos import FrontierGRPO
from dynaforge.envs.vector_env import SharedMemoryVecEnv


def envs(n: int, **kwargs) -> DummyVecEnv:
    return DummyVecEnv([partial(MatchEnv, **kwargs)] * n)


def small(env, policy: str = "MlpPolicy", **kwargs) -> FrontierGRPO:
    options = {"n_groups": 4, "group_size": 4, "seed": 0, "device": "cpu", "policy_kwargs": {"net_arch": [16]}}
    return FrontierGRPO(policy, env, **(options | kwargs))


def weights(model) -> list[np.ndarray]:
    return [p.detach().numpy().copy() for p in model.policy.parameters()]


def equal(a, b) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.fixture
def logged(tmp_path):
    """Return a function that gives a model a logger and hands back the values logged at the last dump."""

    def attach(model) -> dict:
        logger = configure(str(tmp_path), [])
        values = {}
        dump = logger.dump
        logger.dump = lambda step=0: (values.update(logger.name_to_value), dump(step))
        model.set_logger(logger)
        return values

    return attach


# --- learning -------------------------------------------------------------------------------------------------------


def success_rate(model, n: int = 200) -> float:
    env, rng = MatchEnv(), np.random.default_rng(99)
    wins = 0
    for _ in range(n):
        obs, _ = env.reset(**env.condition_sampler.reset_kwargs(env.condition_sampler.draw(rng)))
        done = False
        while not done:
            obs, _, done, _, info = env.step(model.predict(obs, deterministic=True)[0])
        wins += info["is_success"]
    return wins / n


@pytest.mark.parametrize("variant", [{}, {"group_filter": "none", "stratified": False}])
def test_a_toy_is_learned(variant):
    model = FrontierGRPO(
        "MlpPolicy",
        envs(16),
        n_groups=8,
        group_size=8,
        seed=0,
        device="cpu",
        policy_kwargs={"net_arch": [32]},
        **variant,
    )
    before = success_rate(model)
    model.learn(80 * 64 * 3)
    assert before < 0.5
    assert success_rate(model) > 0.85


@pytest.mark.slow
def test_cartpole_improves_with_equal_seeds_as_conditions():
    model = FrontierGRPO(
        "MlpPolicy", DummyVecEnv([lambda: Monitor(gym.make("CartPole-v1"))] * 16), learning_rate=3e-3, n_groups=4,
        group_size=8, group_filter="mixed_return", seed=0, device="cpu", policy_kwargs={"net_arch": [32]},
    )  # fmt: skip
    model.learn(25_000)
    assert evaluate_policy(model, Monitor(gym.make("CartPole-v1")), n_eval_episodes=10)[0] > 100.0


# --- sampling -------------------------------------------------------------------------------------------------------


def test_the_same_conditions_run_whatever_the_number_of_envs():
    ran = {}
    for n in (1, 3, 4, 32):
        env = envs(n)
        small(env).learn(16)
        ran[n] = sorted(name for e in env.envs for name in e.log)
    assert len(ran[1]) == 16
    assert len(set(ran[1])) == 4
    assert ran[1] == ran[3] == ran[4] == ran[32]


def test_worker_processes_give_what_one_process_gives():
    vector = SharedMemoryVecEnv([MatchEnv] * 4, n_workers=2)
    try:
        a = small(vector).learn(200)
    finally:
        vector.close()
    b = small(envs(4)).learn(200)
    assert equal(weights(a), weights(b))


def test_only_gated_transitions_are_used_and_active_steps_are_counted():
    model = small(envs(3), group_filter="none", n_epochs=1).learn(1)
    assert model.num_timesteps == 16 * 3
    assert model.transitions_used == 16 * 2


def test_nominal_steps_count_idle_envs_too():
    model = small(envs(5), timesteps="nominal").learn(1)
    assert model.num_timesteps > 16 * 3
    assert model.num_timesteps % 5 == 0


def test_strata_reach_the_env_in_order():
    model = small(envs(4)).learn(1)
    assert model.last_group_strata.tolist() == [0, 1, 2, 3]
    assert [int(c.difficulty * 4) for c in model.last_group_conditions] == [0, 1, 2, 3]
    assert model.last_group_success.shape == model.last_group_returns.shape == (4, 4)
    assert (small(envs(4), stratified=False).learn(1).last_group_strata == -1).all()


def test_conditions_may_come_from_the_user():
    class Fixed:
        def draw(self, rng, stratum=None, n_strata=1):
            return 7

        def reset_kwargs(self, condition):
            return {"seed": condition}

    model = small(envs(2), condition_sampler=Fixed()).learn(1)
    assert model.last_group_conditions == (7, 7, 7, 7)


def test_resampling_replaces_filtered_groups_and_stops_at_its_cap(logged):
    model = small(envs(4), policy_kwargs={"net_arch": [8], "log_std_init": -9.0}, resample_max=2)
    values = logged(model)
    model.learn(1)  # almost without noise no group is mixed: every round draws all four again
    assert values["frontier/groups_run"] == 12
    assert model.last_group_success.shape == (4, 4)
    assert model.num_timesteps == 3 * 48


def test_replacements_come_from_the_strata_of_the_filtered_groups():
    class Recording(TargetSampler):
        drawn: ClassVar[list[int | None]] = []

        def draw(self, rng, stratum=None, n_strata=1):
            self.drawn.append(stratum)
            return super().draw(rng, stratum, n_strata)

    model = small(envs(4), condition_sampler=Recording(), resample_max=1, n_groups=8).learn(1)
    rate = model.last_group_success.mean(axis=1)
    filtered = np.flatnonzero((rate == 0.0) | (rate == 1.0)).tolist()
    assert 0 < len(filtered) < 8
    assert Recording.drawn == [*range(8), *filtered]


def test_endless_envs_are_ended_at_the_cap():
    model = small(DummyVecEnv([EndlessEnv] * 3), group_filter="mixed_return", max_episode_steps=5).learn(1)
    assert model.num_timesteps == 16 * 5
    assert all(info["l"] == 5 for info in model.ep_info_buffer)


def test_gsde_rollouts_of_a_group_explore_differently():
    model = small(envs(1), use_sde=True, group_filter="none").learn(1)
    first_actions = model.rollout_buffer.actions[::3, 0].reshape(4, 4)  # first decision of each episode, (N, K)
    assert (np.ptp(first_actions, axis=1) > 1e-3).all()


# --- update ---------------------------------------------------------------------------------------------------------


class AlwaysWins(MatchEnv):
    def step(self, action):
        obs, _, done, truncated, info = super().step(action)
        return obs, float(done), done, truncated, info | ({"is_success": True} if done else {})


def test_update_is_skipped_when_no_group_is_mixed(logged):
    model = small(DummyVecEnv([AlwaysWins] * 4))
    before = weights(model)
    values = logged(model)
    model.learn(3 * 48)
    assert equal(before, weights(model))
    assert model.skipped_updates == 3
    assert model.optimizer_steps == model.transitions_used == model._n_updates == 0
    assert values["frontier/skipped_updates"] == 2  # as of the last dump, before the third update
    assert values["frontier/share_all_success"] == 1.0
    assert not any(key in values for key in ("train/loss", "train/approx_kl"))


NAMES = [
    f"{room}/{name}"
    for room, names in {
        "rollout": ("ep_rew_mean", "ep_len_mean", "success_rate"),
        "time": ("fps", "total_timesteps", "collect_s", "collect_cpu_s", "optimize_s", "optimize_cpu_s"),
        "train": (
            "loss",
            "policy_gradient_loss",
            "approx_kl",
            "clip_fraction",
            "learning_rate",
            "std",
            "n_updates",
            "optimizer_steps",
        ),
        "frontier": (
            "share_mixed",
            "share_all_success",
            "share_all_fail",
            "share_kept",
            "transitions_used",
            "idle_share",
            "skipped_updates",
            "success_stratum_00",
            "success_stratum_03",
        ),
    }.items()
    for name in names
]


def test_figures_are_logged_under_the_names_of_sb3(logged):
    model = small(envs(4))
    values = logged(model)
    model.learn(5 * 48)
    assert not [name for name in NAMES if name not in values]
    assert "train/value_loss" not in values
    assert values["train/std"] == pytest.approx(0.3, rel=1e-5)
    shares = [values[f"frontier/share_{kind}"] for kind in ("mixed", "all_success", "all_fail")]
    assert sum(shares) == pytest.approx(1.0)


def test_epochs_and_optimizer_steps_are_counted_apart():
    model = small(envs(4), group_filter="none", n_epochs=3, batch_size=10).learn(1)
    assert model._n_updates == 3
    assert model.optimizer_steps == 3 * 4  # 32 gated transitions in parts of at most 10


@pytest.mark.parametrize("normalise", [False, True])
def test_the_first_step_of_an_update_finds_the_policy_that_acted(logged, normalise):
    env = VecNormalize(envs(3), norm_reward=False) if normalise else envs(3)
    model = small(env, group_filter="none", n_epochs=1, batch_size=None, learning_rate=1e-2)
    values = logged(model)
    model.learn(20 * 48)  # by then actions depend on observations
    assert abs(values["train/approx_kl"]) < 1e-6
    assert np.abs(model.policy.action_net.weight.detach().numpy()).max() > 0.01


def test_target_kl_ends_an_update():
    model = small(envs(4), group_filter="none", n_epochs=50, learning_rate=0.1, target_kl=0.01).learn(1)
    assert model.optimizer_steps < 50


def test_kl_penalty_holds_the_policy_back(logged):
    moved = {}
    for coef in (0.0, 100.0):
        model = small(envs(4), group_filter="none", n_epochs=20, learning_rate=3e-3, kl_coef=coef)
        model.learn(1)
        before = small(envs(1))
        obs = th.rand(64, 3)
        moved[coef] = (
            (model.policy.get_distribution(obs).mode() - before.policy.get_distribution(obs).mode()).abs().mean()
        )
    assert moved[100.0] < 0.5 * moved[0.0]


@pytest.mark.parametrize("option", [{"loss_agg": "episode"}, {"scale_advantage": "batch"}, {"scale_advantage": "none"}])
def test_options_change_the_update(option):
    env = partial(envs, 4, short_when_easy=True)
    plain, other = (
        small(env(), group_filter="mixed_return", learning_rate=1e-2, **extra).learn(48) for extra in ({}, option)
    )
    assert not equal(weights(plain), weights(other))


@pytest.mark.parametrize("where", ["obs", "reward"])
def test_nan_from_the_env_leaves_finite_weights(where):
    model = small(envs(2, nan_at=where))
    with pytest.raises(FloatingPointError, match="condition target-"):
        model.learn(100)
    assert all(np.isfinite(w).all() for w in weights(model))


def test_nan_gradient_is_refused_before_the_optimizer_moves():
    model = small(envs(4), group_filter="none")
    before = weights(model)
    model.policy.action_net.weight.register_hook(lambda grad: grad * float("nan"))
    with pytest.raises(FloatingPointError, match=r"action_net\.weight"):
        model.learn(1)
    assert equal(before, weights(model))


def test_infinite_ratio_is_refused_before_the_optimizer_moves():
    model = small(envs(4), group_filter="none")
    before = weights(model)

    class Spoil(BaseCallback):
        def _on_step(self):
            return True

        def _on_rollout_end(self):
            self.model.rollout_buffer.log_probs[0] = -1e4

    with pytest.raises(FloatingPointError, match="ratio of 1 of"):
        model.learn(1, callback=Spoil())
    assert equal(before, weights(model))


# --- options --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"group_size": 1}, "group_size is 1"),
        ({"n_groups": 0}, "n_groups is 0"),
        ({"group_filter": "mixed_sucess"}, "Did you mean 'mixed_success'"),
        ({"scale_advantage": "std"}, "Unknown scale_advantage 'std'"),
        ({"loss_agg": "steps"}, "Did you mean 'step'"),
        ({"timesteps": "all"}, "'active', 'nominal'"),
        ({"batch_size": 0}, "batch_size is 0"),
        ({"n_epochs": 0}, "n_epochs is 0"),
        ({"resample_max": -1}, "resample_max is -1"),
        ({"clip_range": -0.1}, "clip_range is -0.1"),
        ({"max_grad_norm": 0.0}, "max_grad_norm is 0.0"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        small(envs(1), **options)


def test_mixed_success_on_an_env_without_success_names_the_remedy():
    with pytest.raises(ValueError, match="group_filter='mixed_return'"):
        small(DummyVecEnv([lambda: gym.make("CartPole-v1")])).learn(1)


def test_a_model_without_env_says_what_is_missing(tmp_path):
    with pytest.raises(ValueError, match="needs an env"):
        FrontierGRPO("MlpPolicy", None)
    small(envs(1)).save(tmp_path / "m")
    with pytest.raises(ValueError, match="set_env"):
        FrontierGRPO.load(tmp_path / "m", device="cpu").learn(1)


# --- callbacks ------------------------------------------------------------------------------------------------------


class Watch(BaseCallback):
    """Notes the order of calls, and checks what stock callbacks read."""

    def __init__(self, stop_after: int = 10**9) -> None:
        super().__init__()
        self.calls, self.episodes, self._stop_after = [], 0, stop_after

    def _on_rollout_start(self):
        self.calls.append("start")

    def _on_step(self):
        n = self.training_env.num_envs
        for name in ("infos", "dones", "rewards", "new_obs", "actions"):
            assert len(self.locals[name]) == n
        assert self.locals["env"] is self.training_env
        assert self.locals["rollout_buffer"] is self.model.rollout_buffer
        assert self.num_timesteps == self.model.num_timesteps > 0
        self.episodes += int(np.sum(self.locals["dones"]))
        self.calls.append("step")
        return self.n_calls < self._stop_after

    def _on_rollout_end(self):
        self.calls.append("end")


@pytest.mark.parametrize("n_envs", [1, 3])
def test_callbacks_are_called_as_in_sb3(n_envs):
    watch = Watch()
    model = small(envs(n_envs)).learn(49, callback=watch)
    assert watch.episodes == 32
    assert watch.calls[0] == "start"
    assert watch.calls[-1] == "end"
    assert watch.calls.count("start") == watch.calls.count("end") == 2
    assert model.num_timesteps == 96
    if n_envs == 1:
        assert watch.calls.count("step") == 96


def test_a_callback_stops_training_at_once():
    watch = Watch(stop_after=5)
    model = small(envs(1))
    before = weights(model)
    model.learn(1000, callback=watch)
    assert watch.calls == ["start"] + ["step"] * 5
    assert model.num_timesteps == 5
    assert equal(before, weights(model))
    assert model.learn(48).num_timesteps == 48  # and it may be taken up again


def test_stock_callbacks_work(tmp_path):
    callbacks = [
        EvalCallback(Monitor(MatchEnv()), eval_freq=20, n_eval_episodes=2, log_path=str(tmp_path), verbose=0),
        StopTrainingOnMaxEpisodes(20, verbose=0),  # times n_envs
    ]
    model = small(envs(2)).learn(10_000, callback=callbacks)
    assert 120 <= model.num_timesteps <= 123
    assert (tmp_path / "evaluations.npz").is_file()


def test_the_progress_bar_counts_what_the_algorithm_counts(capsys):
    small(envs(5)).learn(48, progress_bar=True)
    assert "48/48" in capsys.readouterr().err


def test_the_env_is_usable_after_training():
    env = envs(2)
    model = small(env).learn(48)
    assert evaluate_policy(model, env, n_eval_episodes=4, warn=False)[0] >= 0.0


# --- save, load, resume ---------------------------------------------------------------------------------------------


def test_saved_model_predicts_the_same(tmp_path):
    model = small(envs(3)).learn(100)
    model.save(tmp_path / "deep" / "model")
    loaded = FrontierGRPO.load(tmp_path / "deep" / "model.zip", device="cpu")
    obs = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    np.testing.assert_array_equal(model.predict(obs, deterministic=True)[0], loaded.predict(obs, deterministic=True)[0])
    for name in ("n_groups", "group_size", "optimizer_steps", "transitions_used", "num_timesteps", "group_filter"):
        assert getattr(model, name) == getattr(loaded, name)


class SaveAt(BaseCallback):
    def __init__(self, path, at: int) -> None:
        super().__init__()
        self.path, self.at = path, at

    def _on_step(self):
        if self.n_calls == self.at:
            self.model.save(self.path)
        return True


@pytest.mark.parametrize("normalise", [False, True])
def test_resuming_after_an_update_goes_on_bit_for_bit(tmp_path, normalise):
    def env():
        return VecNormalize(envs(3), norm_reward=False) if normalise else envs(3)

    options = {"learning_rate": 1e-2, "batch_size": 8, "group_filter": "mixed_return"}
    whole = small(env(), **options).learn(144)
    whole.learn(144, reset_num_timesteps=False)

    first = small(env(), **options).learn(144)
    first.save(tmp_path / "m")
    kept = first.env
    th.manual_seed(1234)
    resumed = FrontierGRPO.load(tmp_path / "m", env=kept, device="cpu")
    resumed.learn(144, reset_num_timesteps=False)
    assert equal(weights(whole), weights(resumed))
    assert whole.num_timesteps == resumed.num_timesteps
    assert whole.optimizer_steps == resumed.optimizer_steps > 0


def test_a_checkpoint_from_inside_an_iteration_repeats_it_bit_for_bit(tmp_path):
    options = {"learning_rate": 1e-2, "batch_size": 8, "group_filter": "mixed_return"}
    whole = small(envs(3), **options).learn(288, callback=SaveAt(tmp_path / "m", at=40))
    resumed = FrontierGRPO.load(tmp_path / "m", env=envs(3), device="cpu")
    assert resumed.num_timesteps == 96  # steps of whole iterations only
    resumed.learn(192, reset_num_timesteps=False)
    assert equal(weights(whole), weights(resumed))


def test_saving_does_not_disturb_training(tmp_path):
    plain = small(envs(3)).learn(144)
    saving = small(envs(3)).learn(144, callback=SaveAt(tmp_path / "m", at=10))
    assert equal(weights(plain), weights(saving))
    assert plain.num_timesteps == saving.num_timesteps


def test_a_failed_save_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "model.zip"
    model = small(envs(1))
    model.save(path)
    old = path.read_bytes()

    def fail(*args):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        model.learn(48).save(path)
    assert path.read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == ["model.zip"]


def test_checkpoint_holds_no_env(tmp_path):
    model = small(envs(2)).learn(48)
    model.save(tmp_path / "m")
    with zipfile.ZipFile(tmp_path / "m.zip") as archive:
        values = json.loads(archive.read("data")).values()
    pickles = [base64.b64decode(v[":serialized:"]) for v in values if isinstance(v, dict) and ":serialized:" in v]
    assert any(b"CriticFreePolicy" in content for content in pickles)
    assert not any(b"MatchEnv" in content for content in pickles)


def test_equal_seeds_give_equal_models_and_others_do_not():
    a, b, c = (small(envs(3), seed=seed, group_filter="none").learn(96) for seed in (3, 3, 4))
    assert equal(weights(a), weights(b))
    assert not equal(weights(a), weights(c))


# --- spaces ---------------------------------------------------------------------------------------------------------


def test_dict_observations():
    model = small(envs(3, dict_obs=True), "MultiInputPolicy", group_filter="none").learn(48)
    assert model.predict(MatchEnv(dict_obs=True).reset()[0])[0].shape == (1,)
    with pytest.raises(ValueError, match="MultiInputPolicy"):
        small(envs(1, dict_obs=True))


class AnySpaces(gym.Env):
    """Random observations of any space; reward says something about the action."""

    def __init__(self, observations: gym.Space, actions: gym.Space) -> None:
        self.observation_space, self.action_space = observations, actions

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.observation_space.seed(int(self.np_random.integers(2**31)))
        self.t = 0
        return self.observation_space.sample(), {}

    def step(self, action):
        assert self.action_space.contains(action)
        self.t += 1
        reward = float(np.sum(action))
        return self.observation_space.sample(), reward, self.t == 4, False, {"is_success": reward > 0.3}


BOX = gym.spaces.Box(-1.0, 1.0, (2,), np.float64)


@pytest.mark.parametrize(
    ("observations", "actions"),
    [
        (BOX, gym.spaces.Discrete(3)),
        (BOX, gym.spaces.MultiDiscrete([2, 3])),
        (BOX, gym.spaces.MultiBinary(3)),
        (gym.spaces.Discrete(4), gym.spaces.Box(-2.0, 3.0, (2, 2), np.float32)),
        (gym.spaces.MultiDiscrete([3, 2]), BOX),
        (gym.spaces.MultiBinary(3), BOX),
    ],
)
def test_spaces(observations, actions):
    model = small(DummyVecEnv([partial(AnySpaces, observations, actions)] * 3), group_filter="none").learn(64)
    assert model.optimizer_steps > 0


def test_images():
    images = gym.spaces.Box(0, 255, (36, 36, 3), np.uint8)
    env = DummyVecEnv([partial(AnySpaces, images, gym.spaces.Discrete(2))] * 2)
    model = small(env, "CnnPolicy", n_groups=1, group_size=2, group_filter="none", policy_kwargs={})
    model.learn(8)
    assert model.rollout_buffer.observations.dtype == np.uint8


@pytest.mark.parametrize("options", [{}, {"sde_sample_freq": 2}])
def test_gsde_learns_and_loads(tmp_path, options):
    model = small(envs(3), use_sde=True, group_filter="none", **options).learn(96)
    model.save(tmp_path / "m")
    loaded = FrontierGRPO.load(tmp_path / "m", env=envs(1), device="cpu")
    loaded.learn(48, reset_num_timesteps=False)
    assert loaded.optimizer_steps > model.optimizer_steps


def test_learned_sigma_changes_and_fixed_sigma_does_not():
    learned = small(envs(4), group_filter="none", policy_kwargs={"net_arch": [8], "learn_std": True}).learn(48)
    assert abs(learned.policy.log_std.item() - np.log(0.3)) > 1e-5
    assert small(envs(4), group_filter="none").learn(48).policy.log_std.item() == pytest.approx(np.log(0.3))


def test_an_env_id_is_enough():
    model = small("CartPole-v1", n_groups=1, group_size=2, group_filter="mixed_return").learn(1)
    assert model.num_timesteps > 2


def test_schedules_are_followed(logged):
    model = small(
        envs(4), learning_rate=lambda left: 1e-2 * left, clip_range=lambda left: 0.2 * left, group_filter="none"
    )
    values = logged(model)
    model.learn(4 * 48)
    assert values["train/learning_rate"] == pytest.approx(1e-2 * 0.25)
