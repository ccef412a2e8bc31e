"""FrontierGRPO learns: whole-episode sampling under matched conditions, and the update."""

from __future__ import annotations

from functools import partial
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from small_models import envs, equal, small, weights
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize
from toy_envs import EndlessEnv, MatchEnv, TargetSampler

from dynaforge.algos import FrontierGRPO
from dynaforge.sampling.vector_env import SharedMemoryVecEnv

# --- learning --------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    "variant", [{}, pytest.param({"group_filter": "none", "stratified": False}, marks=pytest.mark.slow)]
)
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
        "MlpPolicy",
        DummyVecEnv([lambda: Monitor(gym.make("CartPole-v1"))] * 16),
        learning_rate=3e-3,
        n_groups=4,
        group_size=8,
        group_filter="mixed_return",
        seed=0,
        device="cpu",
        policy_kwargs={"net_arch": [32]},
    )
    model.learn(25_000)
    assert evaluate_policy(model, Monitor(gym.make("CartPole-v1")), n_eval_episodes=10)[0] > 100.0


# --- sampling --------------------------------------------------------------------------------------------------------


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


def test_a_margin_uses_fewer_transitions_of_the_same_rollouts():
    mixed, margin = (small(envs(4), n_groups=16, group_filter=f).learn(1) for f in ("mixed_success", "margin"))
    np.testing.assert_array_equal(mixed.last_group_success, margin.last_group_success)
    wins = mixed.last_group_success.sum(axis=1)
    assert mixed.transitions_used == 8 * ((wins >= 1) & (wins <= 3)).sum()
    assert margin.transitions_used == 8 * (wins == 2).sum() > 0


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


def test_frontier_weights_draw_more_of_what_is_neither_mastered_nor_hopeless(logged):
    model = small(envs(8), n_groups=8, group_size=8, stratum_weights="frontier", learning_rate=0.0)
    values = logged(model)
    trials = np.zeros(8, int)
    for _ in range(12):
        known = model.stratum_record.success.mean()  # logged after the update that it is of, and so one dump later
        model.learn(1, reset_num_timesteps=False)
        trials += np.bincount(model.last_group_strata, minlength=8)
        success = model.last_group_success.mean(axis=1)
        for stratum in set(model.last_group_strata.tolist()):
            own = success[model.last_group_strata == stratum]
            assert values[f"frontier/success_stratum_{stratum:02d}"] == pytest.approx(own.mean())
    assert trials.sum() == 12 * 8
    assert trials.min() >= 3
    assert trials.max() > trials.min()
    assert values["frontier/success"] == pytest.approx(known)


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


class TellsAtItsOwnEnd(MatchEnv):
    """Reports success only when the episode ends by itself: after three steps, or after one where it is easy."""

    def __init__(self) -> None:
        super().__init__(short_when_easy=True)


@pytest.mark.parametrize("cap", ["own", "TimeLimit"])
def test_a_truncated_episode_has_not_succeeded(cap, tmp_path):
    make = TellsAtItsOwnEnd if cap == "own" else lambda: gym.wrappers.TimeLimit(TellsAtItsOwnEnd(), 2)
    env = VecMonitor(DummyVecEnv([make] * 2), str(tmp_path / "m"), info_keywords=("is_success",))
    model = small(env, group_filter="none", max_episode_steps=2 if cap == "own" else None).learn(1)
    won = model.last_group_success
    assert won[:2].any()  # easy ones end in time
    assert not won[2:].any()
    assert np.mean(model.ep_success_buffer) == pytest.approx(won.mean())
    env.close()
    rows = (tmp_path / "m.monitor.csv").read_text().splitlines()[2:]
    assert sum(row.endswith("True") for row in rows) == won.sum()


def test_gated_counting_leaves_out_what_had_no_effect_but_no_episode():
    class NeverGated(MatchEnv):
        def step(self, action):
            *rest, info = super().step(action)
            return *rest, info | {"residual_mask": 0.0}

    assert small(envs(3), timesteps="active").learn(1).num_timesteps == 16 * 3
    assert small(envs(3), timesteps="gated").learn(1).num_timesteps == 16 * 2
    assert small(DummyVecEnv([NeverGated] * 3), timesteps="gated").learn(1).num_timesteps == 16


def test_an_iteration_of_which_nothing_ended_by_itself_teaches_nothing_and_says_so():
    model = small(envs(2), max_episode_steps=1, scale_learning_rate="failures")
    before = weights(model)
    with pytest.warns(UserWarning, match="every episode was cut off"):
        model.learn(1)
    assert model.skipped_updates == 1
    assert equal(before, weights(model))


@pytest.mark.parametrize("total", [1, 100])
def test_no_schedule_sees_progress_beyond_the_end(total):
    seen = []

    def schedule(left):
        seen.append(left)
        return 0.1 * left

    options = {"learning_rate": schedule, "clip_range": schedule, "clip_range_high": schedule}
    model = small(envs(4), group_filter="none", **options).learn(total)
    assert model.num_timesteps > total
    assert min(seen) == 0.0
    assert model.policy.optimizer.param_groups[0]["lr"] == 0.0


@pytest.mark.parametrize("gives", [-1e-3, float("nan")])
def test_a_schedule_that_leaves_its_range_is_refused_by_name(gives):
    model = small(envs(2), group_filter="none", learning_rate=lambda left: 1e-3 if left == 1.0 else gives)
    with pytest.raises(ValueError, match="schedule of learning_rate gives"):
        model.learn(200)


def test_gsde_rollouts_of_a_group_explore_differently():
    model = small(envs(1), use_sde=True, group_filter="none").learn(1)
    first_actions = model.rollout_buffer.actions[::3, 0].reshape(4, 4)  # first decision of each episode, (N, K)
    assert (np.ptp(first_actions, axis=1) > 1e-3).all()


# --- update ----------------------------------------------------------------------------------------------------------


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
            "rim_fraction",
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


@pytest.mark.parametrize("scale", ["none", "failures"])
def test_the_rate_is_scaled_by_the_share_of_failures(scale):
    model = small(envs(4), group_filter="none", learning_rate=1e-2, scale_learning_rate=scale).learn(1)
    failures = 1.0 - model.last_group_success.mean()
    assert 0.0 < failures < 1.0
    expected = 1e-2 * failures if scale == "failures" else 1e-2
    assert model.policy.optimizer.param_groups[0]["lr"] == pytest.approx(expected)


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


@pytest.mark.parametrize(
    "option", [{"loss_agg": "episode"}, *({"scale_advantage": scale} for scale in ("batch", "learnability", "none"))]
)
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


class Renamed(FrontierGRPO):
    """A subclass of its own name."""


@pytest.mark.parametrize(("given", "run"), [({}, "Renamed_1"), ({"tb_log_name": "mine"}, "mine_1")])
def test_tensorboard_shows_a_run_under_the_name_of_its_class_unless_one_is_given(tmp_path, given, run):
    pytest.importorskip("tensorboard")
    model = Renamed("MlpPolicy", envs(2), n_groups=1, group_size=2, device="cpu", tensorboard_log=str(tmp_path))
    model.learn(1, **given)
    assert [path.name for path in tmp_path.iterdir()] == [run]
