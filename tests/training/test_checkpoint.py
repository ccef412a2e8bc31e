from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch as th
from safetensors.torch import save_file
from stable_baselines3 import PPO

from dynaforge.algos import FrontierGRPO
from dynaforge.training.checkpoint import load_checkpoint, save_checkpoint


def model(algorithm: type, *, seed: int = 0, width: int = 8, **options):
    kwargs = options | {
        "policy_kwargs": {"net_arch": [width]},
        "seed": seed,
        "device": "cpu",
        "n_epochs": 1,
        "batch_size": 8,
    }
    if algorithm is PPO:
        return PPO("MlpPolicy", "Pendulum-v1", n_steps=16, **kwargs)
    return FrontierGRPO(
        "MlpPolicy", "Pendulum-v1", n_groups=2, group_size=2, group_filter="none", max_episode_steps=5, **kwargs
    )


@pytest.mark.parametrize("algorithm", [PPO, FrontierGRPO])
def test_a_checkpoint_contains_all_that_an_update_depends_on(algorithm: type, tmp_path: Path) -> None:
    trained, other = model(algorithm).learn(20), model(algorithm, seed=1)
    save_checkpoint(trained, tmp_path / "c")
    load_checkpoint(other, tmp_path / "c", seed=0)
    for mine, theirs in ((trained.policy, other.policy), (trained.policy.optimizer, other.policy.optimizer)):
        for a, b in zip(tensors(mine.state_dict()), tensors(theirs.state_dict()), strict=True):
            assert th.equal(a, b)
    assert (other.num_timesteps, other._n_updates) == (trained.num_timesteps, trained._n_updates)
    if algorithm is FrontierGRPO:
        assert other.condition_rng.bit_generator.state == trained.condition_rng.bit_generator.state
        assert other.optimizer_steps == trained.optimizer_steps > 0


def test_a_checkpoint_contains_the_record_of_the_strata(tmp_path: Path) -> None:
    trained, other = (model(FrontierGRPO, seed=seed, stratum_weights="frontier") for seed in (0, 1))
    trained.stratum_record = trained.stratum_record.after([1], [[True, False, False]])
    save_checkpoint(trained, tmp_path / "c")
    load_checkpoint(other, tmp_path / "c", seed=0)
    assert [other.stratum_record.wins.tolist(), other.stratum_record.losses.tolist()] == [[0, 1], [0, 2]]
    assert other.stratum_record.waits.tolist() == [1, 0]
    save_checkpoint(model(FrontierGRPO), tmp_path / "c")
    with pytest.raises(ValueError, match="no checkpoint of this run"):
        load_checkpoint(other, tmp_path / "c", seed=0)


def tensors(state: object) -> list[th.Tensor]:
    if isinstance(state, dict):
        return [tensor for key in sorted(state, key=str) for tensor in tensors(state[key])]
    return [state] if isinstance(state, th.Tensor) else []


def test_a_file_that_is_not_a_checkpoint_of_the_run_is_refused_in_one_line(tmp_path: Path) -> None:
    path, mine = tmp_path / "c", model(FrontierGRPO)
    save_checkpoint(model(FrontierGRPO, width=4), path)
    wrong = [path.read_bytes(), path.read_bytes()[:200], b"PK\x03\x04", b""]
    for header in ({}, {"counters": {"learn": 1}, "generators": []}, {"counters": [], "generators": {}}, []):
        same = {f"policy.{name}": tensor for name, tensor in mine.policy.state_dict().items()}
        save_file(same, path, {"dynaforge": json.dumps(header)})
        wrong.append(path.read_bytes())
    for data in wrong:
        path.write_bytes(data)
        with pytest.raises(ValueError, match="is no checkpoint of this run, or is damaged") as caught:
            load_checkpoint(mine, path, seed=0)
        assert "\n" not in str(caught.value)
