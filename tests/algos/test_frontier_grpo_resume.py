"""Saving, loading and going on bit for bit."""

from __future__ import annotations

import base64
import json
import os
import zipfile

import numpy as np
import pytest
import torch as th
from small_models import envs, equal, small, weights
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import MlpPolicyFile


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


@pytest.mark.parametrize("at", [8, 40])
def test_a_checkpoint_carries_the_statistics_of_observations(tmp_path, at):
    def env():
        return VecNormalize(envs(3), norm_reward=False)

    options = {"learning_rate": 1e-2, "batch_size": 8, "group_filter": "mixed_return"}
    whole = small(env(), **options).learn(288, callback=SaveAt(tmp_path / "m", at=at))
    resumed = FrontierGRPO.load(tmp_path / "m", env=env(), device="cpu")
    resumed.learn(288 - resumed.num_timesteps, reset_num_timesteps=False)
    assert equal(weights(whole), weights(resumed))
    np.testing.assert_array_equal(whole.env.obs_rms.mean, resumed.env.obs_rms.mean)
    np.testing.assert_array_equal(whole.env.obs_rms.var, resumed.env.obs_rms.var)
    assert whole.env.obs_rms.count == resumed.env.obs_rms.count

    bare = FrontierGRPO.load(tmp_path / "m", env=envs(3), device="cpu")
    with pytest.warns(UserWarning, match="has learned behind VecNormalize, and its env has none"):
        bare.learn(1)
    with pytest.raises(ValueError, match="VecNormalize"):
        MlpPolicyFile.of(FrontierGRPO.load(tmp_path / "m", device="cpu"), task="can")


@pytest.mark.parametrize("at", [8, 100])
def test_a_checkpoint_carries_the_record_of_the_strata(tmp_path, at):
    options = {"learning_rate": 1e-2, "batch_size": 8, "stratum_weights": "frontier"}
    whole = small(envs(3), **options).learn(432, callback=SaveAt(tmp_path / "m", at=at))
    resumed = FrontierGRPO.load(tmp_path / "m", env=envs(3), device="cpu")
    resumed.learn(432 - resumed.num_timesteps, reset_num_timesteps=False)
    assert equal(weights(whole), weights(resumed))
    for name in ("wins", "losses", "waits"):
        np.testing.assert_array_equal(getattr(whole.stratum_record, name), getattr(resumed.stratum_record, name))


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
