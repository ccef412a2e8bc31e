from __future__ import annotations

import warnings
from collections import defaultdict
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from counting_env import CountingEnv, Length
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
    VecTransposeImage,
    VecVideoRecorder,
)

from dynaforge.sampling.dispatch import EpisodeDispatcher
from dynaforge.sampling.job_routes import InProcessRoute, NativeRoute, StockRoute, choose_route, idle_action
from dynaforge.sampling.sampler import Group, Job
from dynaforge.sampling.vector_env import SharedMemoryVecEnv

LENGTHS = [3, 1, 4, 1, 5, 2, 2]


def jobs(lengths=LENGTHS):
    conditions = [Length(i, n) for i, n in enumerate(lengths)]
    return [Job(Group(i, None, c, {"options": {"condition": c}}), 0) for i, c in enumerate(conditions)]


class StockVecEnv(DummyVecEnv):
    """Stands for any VecEnv of which nothing but the VecEnv interface is known."""

    def step_wait(self):
        return super().step_wait()


def dummy(n, **kwargs):
    return DummyVecEnv([lambda: CountingEnv(**kwargs) for _ in range(n)])


def run(dispatcher, todo):
    """Run jobs; return the episode and the observations acted on, each by the job's group."""
    dispatcher.submit(todo)
    episodes, seen = {}, defaultdict(list)
    while dispatcher.busy:
        obs = dispatcher.obs
        tick = dispatcher.step(np.full((dispatcher.n_envs, 1), 0.5, np.float32))
        assert not tick.rewards[~tick.acted].any()
        assert not tick.dones[~tick.acted].any()
        for row in np.flatnonzero(tick.acted):
            seen[tick.jobs[row].group.index].append(np.array(obs[row]).tolist())
        assert [job is not None for job in tick.jobs] == tick.acted.tolist()
        episodes |= {episode.job.group.index: episode for episode in tick.finished}
    dispatcher.release()
    return episodes, seen


VEC_ENVS = {
    "in-process-1": lambda: dummy(1),
    "in-process-3": lambda: dummy(3),
    "in-process-16": lambda: dummy(16),
    "stock-3": lambda: StockVecEnv([CountingEnv] * 3),
    "subproc-2": lambda: SubprocVecEnv([CountingEnv] * 2, start_method="forkserver"),
    "native-1": lambda: SharedMemoryVecEnv([CountingEnv], n_workers=1),
    "native-4": lambda: SharedMemoryVecEnv([CountingEnv] * 4, n_workers=2),
}


@pytest.fixture(params=VEC_ENVS, scope="module")
def vec_env(request):
    env = VEC_ENVS[request.param]()
    yield env
    env.close()


def test_every_job_runs_once_as_a_whole_whatever_the_envs(vec_env):
    dispatcher = EpisodeDispatcher(vec_env)
    for _ in range(2):  # a second submission finds the envs as the first left them
        episodes, seen = run(dispatcher, jobs())
        assert {i: e.length for i, e in episodes.items()} == dict(enumerate(LENGTHS))
        assert {i: e.total_reward for i, e in episodes.items()} == {i: n / 2 for i, n in enumerate(LENGTHS)}
        assert {i: e.success for i, e in episodes.items()} == {i: i % 2 == 0 for i in range(7)}
        assert dict(seen) == {i: [[i, t] for t in range(n)] for i, n in enumerate(LENGTHS)}
        assert all(e.info["episode"]["l"] == e.length for e in episodes.values())
        assert all(e.info["terminal_observation"].tolist() == [i, e.length] for i, e in episodes.items())


def test_long_episodes_end_at_the_cap_whatever_the_envs(vec_env):
    episodes, _ = run(EpisodeDispatcher(vec_env, max_episode_steps=3), jobs([5, 2, 3, 4]))
    assert {i: (e.length, e.capped) for i, e in episodes.items()} == {
        0: (3, True),
        1: (2, False),
        2: (3, False),
        3: (3, True),
    }
    assert episodes[0].info["TimeLimit.truncated"]


def test_routes_are_chosen_by_what_the_vec_env_offers():
    native = SharedMemoryVecEnv([CountingEnv], n_workers=1)
    try:
        assert isinstance(choose_route(native), NativeRoute)
    finally:
        native.close()
    assert isinstance(choose_route(dummy(2)), InProcessRoute)
    assert isinstance(choose_route(StockVecEnv([CountingEnv])), StockRoute)


def test_idle_envs_of_one_process_are_not_stepped():
    env = dummy(4)
    run(EpisodeDispatcher(env, max_episode_steps=6), jobs([6, 1, 9]))
    assert [e.taken for e in env.envs] == [6, 1, 6, 0]
    env = dummy(2)
    run(EpisodeDispatcher(env, max_episode_steps=4), jobs([4, 2, 9, 9]))  # capped envs stop there
    assert [e.taken for e in env.envs] == [8, 6]


def test_idle_rows_are_quiet_and_counted():
    env = StockVecEnv([CountingEnv] * 3)
    dispatcher = EpisodeDispatcher(env)
    dispatcher.submit(jobs([4, 1]))
    actions = np.ones((3, 1), np.float32)
    dispatcher.step(actions)
    tick = dispatcher.step(actions)
    assert tick.acted.tolist() == [True, False, False]
    assert env.actions[:, 0].tolist() == [1.0, 0.0, 0.0]
    assert tick.rewards.tolist() == [1.0, 0.0, 0.0]
    assert not tick.dones.any()
    assert tick.infos[1:] == [{"idle": True}] * 2
    # rows x ticks: one tick to start (2 of 3 rows), one with 2, one with 1
    assert dispatcher.idle_share == pytest.approx((1 + 1 + 2) / 9)


def test_a_free_row_starts_while_others_act():
    dispatcher = EpisodeDispatcher(dummy(2))
    run(dispatcher, jobs([4, 1, 2]))
    assert dispatcher.ticks == 5  # 1 to start both, then 4: row 1 runs job 1, starts job 2, runs it


def test_a_group_stays_with_one_env_until_none_of_its_jobs_is_left():
    groups = [job.group for job in jobs([2, 3, 2])]
    dispatcher = EpisodeDispatcher(dummy(2))
    dispatcher.submit([Job(group, rollout) for rollout in range(4) for group in groups])
    ran = [[], []]
    while dispatcher.busy:
        tick = dispatcher.step(np.full((2, 1), 0.5, np.float32))
        for row in np.flatnonzero(tick.dones):
            ran[row].append(tick.jobs[row].group.index)
    dispatcher.release()
    assert ran == [[0, 0, 0, 0, 2, 2, 2], [1, 1, 1, 1, 2]]


@pytest.mark.parametrize("make", [lambda: dummy(4), lambda: StockVecEnv([CountingEnv] * 4)])
def test_normalisation_counts_exactly_the_observations_acted_on(make):
    env = VecNormalize(make(), norm_reward=False)
    _, seen = run(EpisodeDispatcher(env), jobs([6, 1, 2]))
    expected = np.array([[i, t] for i, n in enumerate([6, 1, 2]) for t in range(n)])
    assert env.obs_rms.count == pytest.approx(9, abs=1e-3)
    np.testing.assert_allclose(env.obs_rms.mean, expected.mean(axis=0), atol=1e-3)
    np.testing.assert_allclose(env.obs_rms.var, expected.var(axis=0), atol=2e-3)
    assert seen[0][1] != [0.0, 1.0]


def test_frozen_normalisation_is_applied_and_not_updated():
    env = VecNormalize(dummy(2), training=False, norm_reward=False)
    env.obs_rms.mean[:], env.obs_rms.var[:] = [1.0, 2.0], [4.0, 4.0]
    before = env.obs_rms.count
    episodes, seen = run(EpisodeDispatcher(env), jobs([2, 1]))
    assert env.obs_rms.count == before
    np.testing.assert_allclose(seen[1], [[0.0, -1.0]], atol=1e-6)
    np.testing.assert_allclose(episodes[0].info["terminal_observation"], [-0.5, 0.0], atol=1e-6)


def test_reward_normalisation_is_left_out_with_a_warning():
    with pytest.warns(UserWarning, match="norm_reward"):
        dispatcher = EpisodeDispatcher(VecNormalize(dummy(1)))
    episodes, _ = run(dispatcher, jobs([4]))
    assert episodes[0].total_reward == 2.0


def test_monitors_count_whole_episodes_only():
    env = VecMonitor(dummy(3))
    run(EpisodeDispatcher(env), jobs())
    assert env.episode_count == len(LENGTHS)
    single = Monitor(CountingEnv())
    run(EpisodeDispatcher(DummyVecEnv([lambda: single])), jobs())
    assert single.get_episode_lengths() == LENGTHS


class Filmed(CountingEnv):
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 7}
    render_mode = "rgb_array"

    def render(self):
        return np.full((16, 16, 3), 20 * self.t, np.uint8)


@pytest.mark.parametrize("make", [lambda: DummyVecEnv([Filmed]), lambda: SharedMemoryVecEnv([Filmed], n_workers=1)])
def test_a_recorder_films_what_is_collected(make, tmp_path):
    pytest.importorskip("moviepy")
    env = VecVideoRecorder(make(), str(tmp_path), lambda step: step == 1, video_length=3)
    assert env.frames_per_sec == 7
    pictures = []
    render = env.venv.render
    env.venv.render = lambda *_: pictures.append(render()) or pictures[-1]
    episodes, _ = run(EpisodeDispatcher(env), jobs([5]))
    env.close()
    assert episodes[0].length == 5
    assert [int(picture[0, 0, 0]) for picture in pictures] == [0, 20, 40, 60]
    assert (tmp_path / "rl-video-step-1-to-step-4.mp4").stat().st_size > 0


def test_a_wrapper_with_state_of_its_own_is_refused():
    with pytest.raises(ValueError, match="VecFrameStack"):
        EpisodeDispatcher(VecFrameStack(dummy(2), 2))


class ImageEnv(CountingEnv):
    observation_space = gym.spaces.Box(0, 255, (36, 40, 3), np.uint8)

    def _obs(self):
        return np.full((36, 40, 3), self.t, np.uint8)


def test_images_are_transposed():
    dispatcher = EpisodeDispatcher(VecTransposeImage(DummyVecEnv([ImageEnv])))
    dispatcher.submit(jobs([1]))
    assert dispatcher.obs.shape == (1, 3, 36, 40)


@pytest.mark.parametrize(
    ("bad", "message"),
    [("obs", r"observation of env 0 is nan at component \[1\] \(rollout 0"), ("reward", "Reward of env 0 is inf")],
)
def test_nan_is_refused_with_its_origin_named(bad, message):
    with pytest.raises(FloatingPointError, match=message):
        run(EpisodeDispatcher(dummy(1, bad=bad)), jobs([3]))


def test_new_jobs_are_refused_while_old_ones_run_and_taken_after_release():
    dispatcher = EpisodeDispatcher(dummy(2))
    dispatcher.submit(jobs())
    with pytest.raises(RuntimeError, match="still running"):
        dispatcher.submit(jobs())
    dispatcher.release()
    episodes, _ = run(dispatcher, jobs([2, 3]))
    assert [episodes[i].length for i in range(2)] == [2, 3]


def test_a_released_vec_env_resets_by_itself_again(vec_env):
    run(EpisodeDispatcher(vec_env), jobs([1, 2]))
    vec_env.reset()
    actions = np.zeros((vec_env.num_envs, 1), np.float32)
    dones = np.array([vec_env.step(actions)[2] for _ in range(5)])
    assert dones[:, 0].tolist() == [False, True, False, True, False]  # episodes of 2 steps, again and again


def test_a_cap_below_one_is_refused():
    with pytest.raises(ValueError, match="max_episode_steps is 0"):
        EpisodeDispatcher(dummy(1), max_episode_steps=0)


@pytest.mark.parametrize(
    "space",
    [
        gym.spaces.Box(0.5, 1.0, (2,)),
        gym.spaces.Discrete(3, start=4),
        gym.spaces.MultiDiscrete([2, 3]),
        gym.spaces.MultiBinary(3),
    ],
)
def test_idle_actions_are_valid(space):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert space.contains(idle_action(space)) or space.contains(idle_action(space).item())
