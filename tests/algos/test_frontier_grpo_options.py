"""FrontierGRPO as any SB3 algorithm: options, callbacks, spaces."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from small_models import envs, equal, small, weights
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback, StopTrainingOnMaxEpisodes
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv
from toy_envs import MatchEnv

from dynaforge.algos import FrontierGRPO
from dynaforge.sampling.vector_env import SharedMemoryVecEnv

# --- options ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"group_size": 1}, "group_size is 1"),
        ({"n_groups": 0}, "n_groups is 0"),
        ({"group_filter": "mixed_sucess"}, "Did you mean 'mixed_success'"),
        ({"group_filter": "margin", "group_size": 3}, "group_size is 3, but must be at least 4"),
        ({"stratum_weights": "frontiers"}, "Did you mean 'frontier'"),
        ({"stratum_weights": "frontier", "stratified": False}, "stratified=False leaves none"),
        ({"scale_advantage": "std"}, "Unknown scale_advantage 'std'"),
        ({"loss_agg": "steps"}, "Did you mean 'step'"),
        ({"exploration": "jobs"}, "Did you mean 'job'"),
        ({"timesteps": "all"}, "'active', 'gated', 'nominal'"),
        ({"batch_size": 0}, "batch_size is 0"),
        ({"n_epochs": 0}, "n_epochs is 0"),
        ({"resample_max": -1}, "resample_max is -1"),
        ({"clip_range": -0.1}, "clip_range is -0.1"),
        ({"max_grad_norm": 0.0}, "max_grad_norm is 0.0"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
        ({"scale_learning_rate": "failure"}, "Did you mean 'failures'"),
        ({"target_kl": -1}, "target_kl is -1"),
        ({"clip_range_high": float("nan")}, "clip_range_high is nan"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": 2**32}, "seed is 4294967296"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        small(envs(1), **options)


NUMBERS = {
    "whole": ("n_groups", "group_size", "n_epochs", "batch_size", "resample_max", "max_episode_steps", "seed"),
    "real": (
        "learning_rate",
        "clip_range",
        "clip_range_high",
        "kl_coef",
        "anchor_coef",
        "target_kl",
        "desired_kl",
        "max_grad_norm",
    ),
}
BAD = {"whole": (2.5, "8", True, -2, float("nan")), "real": ("fast", -1.0, float("nan"), True, [1.0])}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in NUMBERS.items() for name in names])
def test_a_bad_number_is_refused_at_construction_in_one_line_that_names_it(kind, name):
    for value in BAD[kind]:
        with pytest.raises((TypeError, ValueError)) as caught:
            small(envs(1), **{name: value})
        assert str(caught.value).startswith(f"{name} is {value!r}")
        assert "must be" in str(caught.value)


@pytest.mark.parametrize("steps", [-5, 0, float("nan"), float("inf"), "many", None])
def test_learning_for_no_time_is_refused(steps):
    with pytest.raises((TypeError, ValueError), match=f"total_timesteps is {steps!r}"):
        small(envs(1)).learn(steps)


@pytest.mark.parametrize("seed", [None, 0, 2**32 - 1])
def test_every_seed_works(seed):
    small(envs(2), seed=seed).learn(1)


def test_mixed_success_on_an_env_without_success_names_the_remedy():
    with pytest.raises(ValueError, match="group_filter='mixed_return'"):
        small(DummyVecEnv([lambda: gym.make("CartPole-v1")])).learn(1)


@pytest.mark.parametrize(
    ("option", "remedy"),
    [
        ({"group_filter": "margin"}, "group_filter='mixed_return'"),
        ({"scale_advantage": "learnability"}, "scale_advantage='group'"),
        ({"stratum_weights": "frontier"}, "stratum_weights='equal'"),
    ],
)
def test_what_reads_success_names_its_remedy_on_an_env_without(option, remedy):
    with pytest.raises(ValueError, match=remedy):
        small(DummyVecEnv([lambda: gym.make("CartPole-v1")]), **{"group_filter": "none"} | option).learn(1)


def test_a_rate_by_failures_on_an_env_without_success_names_the_remedy():
    env = DummyVecEnv([lambda: gym.make("CartPole-v1")])
    with pytest.raises(ValueError, match="scale_learning_rate='none'"):
        small(env, group_filter="mixed_return", scale_learning_rate="failures").learn(1)


def test_a_model_without_env_says_what_is_missing(tmp_path):
    with pytest.raises(ValueError, match="needs an env"):
        FrontierGRPO("MlpPolicy", None)
    small(envs(1)).save(tmp_path / "m")
    with pytest.raises(ValueError, match="set_env"):
        FrontierGRPO.load(tmp_path / "m", device="cpu").learn(1)


# --- callbacks -------------------------------------------------------------------------------------------------------


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


class Raises(BaseCallback):
    def __init__(self, what: BaseException, at: int) -> None:
        super().__init__()
        self._what, self._at = what, at

    def _on_step(self):
        if self.n_calls == self._at:
            raise self._what
        return True


@pytest.mark.parametrize("what", [KeyboardInterrupt(), ValueError("from a callback")])
@pytest.mark.parametrize("kind", ["native", "in process"])
def test_an_interrupted_iteration_gives_the_env_back(what, kind):
    fns = [MatchEnv] * 3
    env = SharedMemoryVecEnv(fns, n_workers=1) if kind == "native" else DummyVecEnv(fns)
    try:
        for at in (2, 5, 6):  # among others while a row has ended and waits for its next episode
            model = small(env)
            with pytest.raises(type(what)):
                model.learn(1000, callback=Raises(what, at))
            ended = 0
            for _ in range(8):  # without a reset: no row stays idle
                *_, dones, infos = env.step(np.zeros((3, 1), np.float32))
                assert not any("idle" in info for info in infos)
                ended += int(dones.sum())
            assert ended >= 3
            assert evaluate_policy(model, env, n_eval_episodes=4, warn=False)[0] >= 0.0
    finally:
        env.close()


def test_the_env_is_usable_after_training():
    env = envs(2)
    model = small(env).learn(48)
    assert evaluate_policy(model, env, n_eval_episodes=4, warn=False)[0] >= 0.0


# --- spaces ----------------------------------------------------------------------------------------------------------


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
