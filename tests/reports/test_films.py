"""A film has one picture per control step, and filming an episode does not change it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo
from stable_baselines3.common.vec_env import DummyVecEnv, VecVideoRecorder

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.sampling.vector_env import SharedMemoryVecEnv
from dynaforge.sim import SimScene
from dynaforge.sim.spec import asset_path


@pytest.fixture
def blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw nothing: what is counted here is when pictures are taken."""
    monkeypatch.setattr(SimScene, "picture", lambda self, camera: np.zeros((4, 6, 3), np.uint8))


def run(env: gym.Env[Any, Any], policy: Any, *, seed: int = 1, render: bool = False) -> dict[str, Any]:
    """Run an episode; return its decisions, its states by time and its end, with the time after each step."""
    inner = env.unwrapped
    states: dict[float, bytes] = {}
    decisions = []
    observation, _ = env.reset(seed=seed)
    if render:
        inner.render()
    inner.world.listeners.append(lambda step: states.update({step.after.time: step.after.q.tobytes()}))
    times, done = [], False
    while not done:
        if render:
            inner.render()
        times.append(inner.world.state.time)
        seen = observation
        observation, reward, done, _, info = env.step(policy(seen))
        if info["residual_mask"]:
            decisions.append(seen.tobytes())
        assert info["is_success"] is (done and reward == 1.0)
    inner.world.listeners.clear()
    times.append(inner.world.state.time)
    end = (info["is_success"], info["failure"], info["phase"], reward)
    return {"decisions": decisions, "states": states, "end": end, "times": times, "last": observation.tobytes()}


@pytest.mark.parametrize(("task", "gate_mode"), [("can", "skip"), ("can", "mask"), ("peach", "skip")])
def test_a_filmed_episode_is_the_same_episode(task: str, gate_mode: str, blank: None) -> None:
    policy = MlpPolicyFile.load(asset_path(f"{task}/policy.safetensors"), task=task)
    env = ResidualEnv(task, gate_mode=gate_mode, render_mode="rgb_array")
    plain, filmed = run(env, policy), run(env, policy, render=True)
    assert filmed["decisions"] == plain["decisions"]
    assert [filmed[key] for key in ("end", "last")] == [plain[key] for key in ("end", "last")]
    assert filmed["states"].items() >= plain["states"].items()
    dt = env.task.scene.control_dt
    np.testing.assert_allclose(np.diff(filmed["times"]), dt, atol=1e-9)
    assert filmed["times"][0] == 0.0
    assert len(plain["times"]) < len(filmed["times"]) / 2
    again = run(env, policy)
    assert again == plain, "and a film leaves nothing behind"
    env.close()


def test_pictures_that_stop_and_start_leave_the_decisions_alone(blank: None) -> None:
    policy = MlpPolicyFile.load(asset_path("can/policy.safetensors"), task="can")
    env = ResidualEnv("can", render_mode="rgb_array")
    plain = run(env, policy)
    sometimes = iter(np.random.default_rng(0).random(1000) < 0.6)
    render, env.render = env.render, lambda: render() if next(sometimes) else None  # type: ignore[method-assign]
    mixed = run(env, policy, render=True)
    assert (mixed["decisions"], mixed["end"]) == (plain["decisions"], plain["end"])
    env.close()


def test_every_recorder_takes_a_picture_per_control_step(blank: None, tmp_path: Path) -> None:
    zero = np.zeros(5, np.float32)
    listed = gym.make("DynaForge/Can-v0", render_mode="rgb_array_list")
    recorded = RecordVideo(gym.make("DynaForge/Can-v0", render_mode="rgb_array"), str(tmp_path / "film"))
    for env, frames in ((listed, lambda: listed.render()), (recorded, lambda: recorded.recorded_frames)):
        env.reset(seed=3)
        for _ in range(40):
            done = env.step(zero)[2]
            assert not done
        world = env.unwrapped.world
        assert len(frames()) == 41
        assert world.state.time == pytest.approx(40 / env.metadata["render_fps"])
        recorded.recorded_frames, recorded.recording = [], False  # there is nothing worth writing
        env.close()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dummy", "shared"])
def test_the_films_of_vectorised_envs_are_as_long_as_the_episode(kind: str, tmp_path: Path) -> None:
    from moviepy import VideoFileClip

    make = partial(ResidualEnv, "can", render_mode="rgb_array")
    envs = DummyVecEnv([make]) if kind == "dummy" else SharedMemoryVecEnv([make])
    env = VecVideoRecorder(envs, str(tmp_path), record_video_trigger=lambda step: step == 0, video_length=40)
    env.seed(3)
    env.reset()
    for _ in range(40):
        assert not env.step(np.zeros((1, 5), np.float32))[2].any()
    if kind == "dummy":
        assert envs.envs[0].world.state.time == pytest.approx(40 / 30)
    env.step(np.zeros((1, 5), np.float32))
    env.close()
    with VideoFileClip(str(next(tmp_path.glob("*.mp4")))) as film:
        assert film.duration == pytest.approx(41 / 30, abs=0.05)
