from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from stable_baselines3 import SAC
from toy_envs import MatchEnv

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import MlpPolicyFile


@pytest.fixture(scope="module")
def model() -> FrontierGRPO:
    model = FrontierGRPO("MlpPolicy", MatchEnv(), seed=0)
    with th.no_grad():
        model.policy.action_net.weight.normal_(generator=th.Generator().manual_seed(1))
    return model


def observations(model: FrontierGRPO, n: int = 20) -> np.ndarray:
    assert isinstance(model.observation_space, spaces.Box)
    return np.random.default_rng(0).normal(size=(n, *model.observation_space.shape)).astype(np.float32)


def test_policy_file_acts_as_the_model_does_without_exploration(model: FrontierGRPO) -> None:
    policy = MlpPolicyFile.of(model, task="toy")
    for observation in observations(model):
        expected, _ = model.predict(observation, deterministic=True)
        np.testing.assert_allclose(policy(observation), expected, atol=1e-5)


def test_policy_file_survives_the_disk_to_the_bit(model: FrontierGRPO, tmp_path: Path) -> None:
    policy = MlpPolicyFile.of(model, task="toy", meta={"seed": 3})
    policy.save(tmp_path / "p.safetensors")
    read = MlpPolicyFile.load(tmp_path / "p.safetensors", task="toy")
    assert read.digest == policy.digest
    assert read.meta == {"seed": 3}
    for observation in observations(model):
        assert np.array_equal(read(observation), policy(observation))


def test_policy_of_another_task_is_refused(model: FrontierGRPO, tmp_path: Path) -> None:
    MlpPolicyFile.of(model, task="toy").save(tmp_path / "p.safetensors")
    with pytest.raises(ValueError, match="policy for task 'toy', not for 'can'"):
        MlpPolicyFile.load(tmp_path / "p.safetensors", task="can")


def test_missing_and_damaged_policy_files_are_named(model: FrontierGRPO, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"gone\.safetensors"):
        MlpPolicyFile.load(tmp_path / "gone.safetensors")
    path = tmp_path / "p.safetensors"
    MlpPolicyFile.of(model, task="toy").save(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"p\.safetensors is no dynaforge policy file"):
        MlpPolicyFile.load(path)


def test_only_an_mlp_becomes_a_policy_file() -> None:
    other = SAC("MlpPolicy", MatchEnv(), buffer_size=1)
    with pytest.raises(ValueError, match="Only an MLP policy can be written as a policy file, not SACPolicy"):
        MlpPolicyFile.of(other, task="toy")
