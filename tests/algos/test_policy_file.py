from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from gymnasium.wrappers import NormalizeObservation
from safetensors.numpy import save
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from toy_envs import MatchEnv

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policies import CriticFreePolicy
from dynaforge.algos.policy_file import FORMAT, MlpPolicyFile
from dynaforge.cli.main import main
from dynaforge.envs.observation import residual_sizes
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import TASK_NAMES, get_task
from dynaforge.tasks.digest import definition_of

N_OBS, N_ACT = residual_sizes(get_task("can"))


class SizedAsCan(gym.Env):
    """The spaces of Can's residual env, and nothing behind them."""

    observation_space = spaces.Box(-10.0, 10.0, (N_OBS,), np.float32)

    def __init__(self, reach: float = 1.0) -> None:
        self.action_space = spaces.Box(-reach, reach, (N_ACT,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        return np.zeros(N_OBS, np.float32), {}

    def step(self, action):
        return np.zeros(N_OBS, np.float32), 0.0, True, False, {"is_success": False}


def trained(model: Any) -> Any:
    """Give every layer weights of some size, as training would."""
    with th.no_grad():
        next(model.policy.action_net.parameters()).normal_(generator=th.Generator().manual_seed(1))
    return model


@pytest.fixture(scope="module")
def model() -> FrontierGRPO:
    return trained(FrontierGRPO("MlpPolicy", SizedAsCan(), seed=0))


def observations(n: int = 20) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(n, N_OBS)).astype(np.float32)


@pytest.mark.parametrize(
    ("algorithm", "options"),
    [
        (FrontierGRPO, {}),
        (FrontierGRPO, {"use_sde": True}),
        (FrontierGRPO, {"policy_kwargs": {"net_arch": []}}),
        (FrontierGRPO, {"policy_kwargs": {"squash_mean": True}}),
        (PPO, {"policy_kwargs": {"activation_fn": th.nn.ReLU}}),
        (PPO, {"use_sde": True, "policy_kwargs": {"net_arch": [16, 16, 16], "share_features_extractor": False}}),
    ],
)
def test_policy_file_acts_as_the_model_does_without_exploration(algorithm, options) -> None:
    model = trained(algorithm("MlpPolicy", SizedAsCan(), seed=0, device="cpu", **options))
    policy = MlpPolicyFile.of(model, task="can")
    for observation in observations():
        expected, _ = model.predict(observation, deterministic=True)
        np.testing.assert_allclose(policy(observation), expected, atol=1e-5)


def test_a_file_knows_whether_its_mean_is_squashed(tmp_path: Path) -> None:
    plain, squashed = (
        MlpPolicyFile.of(
            trained(FrontierGRPO("MlpPolicy", SizedAsCan(), seed=0, policy_kwargs={"squash_mean": squash})), task="can"
        )
        for squash in (False, True)
    )
    assert plain.digest != squashed.digest
    for policy in (plain, squashed):
        policy.save(tmp_path / "p")
        loaded = MlpPolicyFile.load(tmp_path / "p")
        assert (loaded.digest, loaded.squash_mean) == (policy.digest, policy.squash_mean)
        np.testing.assert_array_equal(loaded(observations()[0]), policy(observations()[0]))


class OwnExtractor(BaseFeaturesExtractor):
    def __init__(self, space: spaces.Box) -> None:
        super().__init__(space, features_dim=space.shape[0])

    def forward(self, observations: th.Tensor) -> th.Tensor:
        return 2.0 * observations


class Reversed(gym.ActionWrapper):
    def action(self, action: np.ndarray) -> np.ndarray:
        return -action


class OwnPolicy(CriticFreePolicy):
    pass


def normalised() -> VecNormalize:
    return VecNormalize(DummyVecEnv([SizedAsCan]), norm_reward=False)


@pytest.mark.parametrize(
    ("build", "what"),
    [
        (lambda: SAC("MlpPolicy", SizedAsCan(), buffer_size=1), "not SACPolicy"),
        (lambda: FrontierGRPO(OwnPolicy, SizedAsCan()), "not OwnPolicy"),
        (lambda: FrontierGRPO("MlpPolicy", normalised()), "VecNormalize"),
        (lambda: PPO("MlpPolicy", normalised(), device="cpu"), "VecNormalize"),
        (
            lambda: PPO("MlpPolicy", NormalizeObservation(SizedAsCan()), device="cpu"),
            "in a gymnasium.ObservationWrapper",
        ),
        (lambda: FrontierGRPO("MlpPolicy", Reversed(SizedAsCan())), "in a gymnasium.ActionWrapper"),
        (
            lambda: FrontierGRPO("MlpPolicy", SizedAsCan(), use_sde=True, policy_kwargs={"squash_output": True}),
            "squashes its output",
        ),
        (
            lambda: FrontierGRPO("MlpPolicy", SizedAsCan(), policy_kwargs={"features_extractor_class": OwnExtractor}),
            "features extractor OwnExtractor",
        ),
        (lambda: FrontierGRPO("MlpPolicy", SizedAsCan(), policy_kwargs={"activation_fn": th.nn.ELU}), "ELU; Tanh"),
        (lambda: FrontierGRPO("MlpPolicy", SizedAsCan(reach=2.0)), r"gives actions in \[-1, 1\]"),
        (lambda: FrontierGRPO("MlpPolicy", "CartPole-v1", group_filter="none"), "acts in Discrete"),
        (lambda: FrontierGRPO("MlpPolicy", MatchEnv()), f"takes 3 numbers and gives 1.*'can' has {N_OBS} and its"),
    ],
)
def test_what_a_policy_file_cannot_hold_is_refused_by_name(build, what) -> None:
    with pytest.raises(ValueError, match=f"written as a policy file.*{what}"):
        MlpPolicyFile.of(build(), task="can")


def test_weights_that_are_not_finite_are_refused(model: FrontierGRPO) -> None:
    other = trained(FrontierGRPO("MlpPolicy", SizedAsCan(), seed=0))
    with th.no_grad():
        other.policy.action_net.bias[2] = float("nan")
    with pytest.raises(ValueError, match="layer 2 holds NaN or infinity"):
        MlpPolicyFile.of(other, task="can")


def test_policy_file_survives_the_disk_to_the_bit(model: FrontierGRPO, tmp_path: Path) -> None:
    policy = MlpPolicyFile.of(model, task="can", meta={"seed": 3})
    policy.save(tmp_path / "p.safetensors")
    read = MlpPolicyFile.load(tmp_path / "p.safetensors", task="can")
    assert read.digest == policy.digest
    assert read.meta == {"seed": 3} | definition_of(get_task("can"))
    for observation in observations():
        assert np.array_equal(read(observation), policy(observation))


def test_policy_of_another_or_an_unknown_task_is_refused(model: FrontierGRPO, tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    policy = MlpPolicyFile.of(model, task="can")
    policy.save(path)
    with pytest.raises(ValueError, match="policy for task 'can', not for 'pen'"):
        MlpPolicyFile.load(path, task="pen")
    for unknown in ("nonsense", "ball.py", ""):
        policy.task = unknown
        policy.save(path)
        with pytest.raises(
            ValueError, match=rf"p\.safetensors is a policy for task '{unknown}', which is none of can,"
        ):
            MlpPolicyFile.load(path)
        with pytest.raises(ValueError, match="No task"):
            MlpPolicyFile.of(model, task=unknown or "nil")


@pytest.mark.parametrize("task", TASK_NAMES)
def test_the_sizes_of_a_task_are_known_without_its_env(task: str) -> None:
    MlpPolicyFile.load(asset_path(f"{task}/policy.safetensors"), task=get_task(task))


def test_the_sizes_are_those_of_the_env() -> None:
    env = ResidualEnv("pen")
    assert residual_sizes(env.task) == (env.observation_space.shape[0], env.action_space.shape[0])
    env.close()


def layers(*sizes: int, **changes: Any) -> dict[str, np.ndarray]:
    tensors = {}
    for k, (n, m) in enumerate(pairwise(sizes)):
        tensors |= {f"{k}.weight": np.full((m, n), 0.01, np.float32), f"{k}.bias": np.zeros(m, np.float32)}
    return tensors | changes


GOOD = {"format": FORMAT, "task": "can", "activation": "Tanh", "meta": {}}
SIZES = (N_OBS, 8, N_ACT)
DAMAGED = {
    "no header": (None, layers(*SIZES)),
    "header is no JSON": ("{", layers(*SIZES)),
    "header is deep": ("[" * 100_000, layers(*SIZES)),
    **{f"header is {value!r}": (value, layers(*SIZES)) for value in ([], "x", None, 3)},
    **{
        f"{name} is {value!r}": (GOOD | {name: value}, layers(*SIZES))
        for name, values in {
            "format": ("other", 1, None),
            "task": (1, None, ["can"], {}),
            "activation": ("ELU", 3, None, []),
            "meta": (None, [], "x"),
        }.items()
        for value in values
    },
    "no layer": (GOOD, {}),
    "a layer is missing": (GOOD, {k: v for k, v in layers(*SIZES, N_ACT).items() if k[0] != "1"}),
    "a tensor too many": (GOOD, layers(*SIZES, extra=np.zeros(1, np.float32))),
    "layers that do not chain": (GOOD, layers(*SIZES, **{"1.weight": np.zeros((N_ACT, 7), np.float32)})),
    "a bias of another width": (GOOD, layers(*SIZES, **{"0.bias": np.zeros(7, np.float32)})),
    "a weight that is a vector": (GOOD, layers(*SIZES, **{"0.weight": np.zeros(8, np.float32)})),
    "doubles": (GOOD, layers(*SIZES, **{"0.bias": np.zeros(8)})),
    "NaN": (GOOD, layers(*SIZES, **{"0.bias": np.full(8, np.nan, np.float32)})),
    "infinity": (GOOD, layers(*SIZES, **{"1.bias": np.full(N_ACT, np.inf, np.float32)})),
    "one input too few": (GOOD, layers(N_OBS - 1, 8, N_ACT)),
    "one output too many": (GOOD, layers(N_OBS, 8, N_ACT + 1)),
}


def written(path: Path, header: Any, tensors: dict[str, np.ndarray]) -> Path:
    text = header if isinstance(header, str) and header[:1] in "{[" else json.dumps(header)
    path.write_bytes(save(tensors, {"dynaforge": text} if header is not None else {}))
    return path


def refusal(path: Path) -> str:
    with pytest.raises(ValueError, match=path.name) as caught:
        MlpPolicyFile.load(path, task="can")
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    return message


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_policy_file_is_refused_in_one_line_that_names_it(damage: str, tmp_path: Path) -> None:
    MlpPolicyFile.load(written(tmp_path / "good.safetensors", GOOD, layers(*SIZES)), task="can")
    refusal(written(tmp_path / "p.safetensors", *DAMAGED[damage]))


def test_no_change_of_bytes_gets_past_the_check_as_anything_but_a_policy(tmp_path: Path) -> None:
    """Cut, flip and shuffle: either the file is refused in one line, or it acts like any policy."""
    rng = np.random.default_rng(0)
    path = written(tmp_path / "p.safetensors", GOOD, layers(*SIZES))
    whole = path.read_bytes()
    for cut in (0, 1, 7, 8, 9, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:cut])
        refusal(path)
    refused = []
    for _ in range(200):
        changed = bytearray(whole)
        for at in rng.integers(400, size=rng.integers(1, 4)):
            changed[at] = rng.integers(256)
        path.write_bytes(changed)
        try:
            policy = MlpPolicyFile.load(path, task="can")
        except ValueError as error:
            refused.append(str(error))
        else:
            assert policy(np.zeros(N_OBS, np.float32)).shape == (N_ACT,)
    assert len(refused) > 100
    assert all("p.safetensors" in message and "\n" not in message for message in refused)


def test_missing_policy_files_are_named(tmp_path: Path) -> None:
    for path in (tmp_path / "gone.safetensors", tmp_path):
        with pytest.raises(FileNotFoundError, match=path.name):
            MlpPolicyFile.load(path)


@pytest.mark.parametrize("command", ["collect", "evaluate"])
def test_commands_refuse_a_policy_that_does_not_fit_before_any_work(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "p.safetensors", GOOD, layers(N_OBS - 1, 8, N_ACT))
    asked = ["--task", "can", "--generator", "residual", "--policy", str(path), "--out", str(tmp_path / "out")]
    assert main([command, *asked, "--attempts", "1"]) == 2
    error = capsys.readouterr().err
    assert f"takes {N_OBS - 1} numbers" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
