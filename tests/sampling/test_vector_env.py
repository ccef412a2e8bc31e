from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from types import SimpleNamespace

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from dynaforge.sampling.vector_env import SharedMemoryVecEnv, WorkerDied, WorkerFailed

# The toy envs travel by value: workers need not import this file, and with it torch.
cloudpickle.register_pickle_by_value(sys.modules[__name__])


class RandomWalk(gym.Env):
    """Episodes of random length and end; `options` may carry a condition, a fixed length, or a misfortune."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 12}
    misfortune = ""

    def __init__(self, colour=0, render_mode="rgb_array"):
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (3,), np.float32)
        self.action_space = gym.spaces.Box(-1, 1, (2,), np.float32)
        self.render_mode = render_mode
        self.colour = colour
        self.n_steps = 0  # over the env's whole life

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        options = options or {}
        self.length = options.get("length") or int(self.np_random.integers(2, 7))
        self.misfortune = options.get("misfortune", self.misfortune)
        self.position, self.age = self.np_random.normal(size=3), 0
        return self.position.astype(np.float32), {"length": self.length}

    def step(self, action):
        if self.misfortune == "raise":
            raise ZeroDivisionError("wheel fell off")
        while self.misfortune == "hang":
            time.sleep(0.05)
        self.n_steps += 1
        self.age += 1
        self.position[:2] += action
        over = self.age >= self.length
        truncated = bool(over and self.length % 2)
        info = {"age": self.age} if self.age % 2 else {}
        return self.position.astype(np.float32), float(self.position[0]), over and not truncated, truncated, info

    def render(self):
        return np.full((4, 4, 3), self.colour, np.uint8)

    def double(self, value, plus=0):
        return 2 * value + plus

    def modules(self):
        return sorted(sys.modules)

    def pid(self):
        return os.getpid()


class Named(gym.Wrapper):
    pass


class Structured(gym.Env):
    observation_space = gym.spaces.Dict(
        {"image": gym.spaces.Box(0, 255, (2, 2), np.uint8), "count": gym.spaces.Discrete(100)}
    )
    action_space = gym.spaces.Discrete(5)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = int(self.np_random.integers(50))
        return self._observe(0), {}

    def step(self, action):
        self.count += 1
        return self._observe(int(action)), 1.0, self.count % 7 == 0, False, {}

    def _observe(self, value):
        return {"image": np.full((2, 2), value, np.uint8), "count": np.int64(self.count)}


@pytest.fixture
def make():
    made = []

    def build(n_envs, n_workers=2, *, timeout=20.0, env_class=RandomWalk):
        fns = [lambda colour=i: Named(env_class(colour)) for i in range(n_envs)]
        made.append(SharedMemoryVecEnv(fns, n_workers=n_workers, timeout=timeout))
        return made[-1]

    yield build
    for env in made:
        env.close()


def running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0] != "Z"


def gone_within(pids, seconds):
    deadline = time.monotonic() + seconds
    while any(running(pid) for pid in pids):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def with_condition(name, **options):
    return {"options": {"condition": SimpleNamespace(id=name), **options}}


def same(a, b):
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    return a == b


def assert_same_rollout(ours, theirs, *, n_steps, draw):
    for env in (ours, theirs):
        env.seed(7)
    assert same(ours.reset(), theirs.reset())
    assert ours.reset_infos == theirs.reset_infos
    n_done = 0
    for _ in range(n_steps):
        actions = draw()
        mine, reference = ours.step(actions), theirs.step(actions)
        for got, expected in zip(mine[:3], reference[:3], strict=True):
            assert same(got, expected)
        assert all(same(a, b) for a, b in zip(mine[3], reference[3], strict=True)), (mine[3], reference[3])
        assert ours.reset_infos == theirs.reset_infos
        n_done += int(mine[2].sum())
    assert n_done > n_steps // 4


@pytest.mark.parametrize("n_workers", [1, 2, 9])
def test_rollouts_equal_those_of_dummy_vec_env(make, n_workers):
    rng = np.random.default_rng(0)
    ours = make(5, n_workers)
    theirs = DummyVecEnv([lambda i=i: Named(RandomWalk(i)) for i in range(5)])
    assert_same_rollout(ours, theirs, n_steps=60, draw=lambda: rng.uniform(-1, 1, (5, 2)).astype(np.float32))


def test_dict_observations_and_discrete_actions_equal_those_of_dummy_vec_env():
    rng = np.random.default_rng(0)
    ours = SharedMemoryVecEnv([Structured] * 3)
    assert_same_rollout(ours, DummyVecEnv([Structured] * 3), n_steps=30, draw=lambda: rng.integers(5, size=3))
    ours.close()


def test_returned_arrays_and_infos_are_not_overwritten_by_later_steps(make):
    env = make(2)
    env.seed(0)
    env.reset()
    first = env.step(np.ones((2, 2)))
    kept = [array.copy() for array in first[:3]]
    for _ in range(10):
        env.step(np.ones((2, 2)))
    assert all(np.array_equal(now, then) for now, then in zip(first[:3], kept, strict=True))
    assert first[3][0] == {"age": 1, "TimeLimit.truncated": False}


def test_options_of_reset_reach_every_env_once(make):
    env = make(2)
    env.set_options([{"length": 4}, {"length": 6}])
    env.reset()
    assert [info["length"] for info in env.reset_infos] == [4, 6]
    assert env.get_attr("length") == [4, 6]


def test_attributes_methods_wrappers_and_images_reach_the_env_named(make):
    env = make(5)
    assert env.get_attr("colour", [4, 0, 2]) == [4, 0, 2]
    env.set_attr("note", [1], indices=3)
    assert env.get_attr("note", 3) == [[1]]
    assert env.env_method("double", 4, plus=1, indices=[1, 3]) == [9, 9]
    assert env.env_is_wrapped(Named) == [True] * 5
    assert env.env_is_wrapped(gym.wrappers.TimeLimit, indices=[0]) == [False]
    assert env.has_attr("colour")
    assert not env.has_attr("weight")
    with pytest.raises(AttributeError, match="weight"):
        env.get_attr("weight")
    assert [int(image[0, 0, 0]) for image in env.get_images()] == [0, 1, 2, 3, 4]
    assert env.render().shape == (12, 8, 3)
    assert env.metadata["render_fps"] == 12


class Burning(RandomWalk):
    """Uses processor time when it is told to."""

    def burn(self, seconds):
        end = time.process_time() + seconds
        while time.process_time() < end:
            pass


def test_the_processor_time_of_every_worker_counts_once():
    env = SharedMemoryVecEnv([Burning] * 4, n_workers=2)
    before, own = env.processor_seconds(), time.process_time()
    env.env_method("burn", 0.15, indices=[0, 1, 3])  # two of them in one worker
    spent = env.processor_seconds() - before
    env.close()
    assert 0.45 <= spent < 0.6
    assert time.process_time() - own < 0.15


def test_workers_run_without_torch_and_single_threaded(make):
    env = make(2)
    for modules in env.env_method("modules"):
        assert "torch" not in modules
        assert "stable_baselines3" not in modules
    assert len(set(env.env_method("pid")) | {os.getpid()}) == 3


def test_a_parked_env_idles_until_it_is_assigned_an_episode(make):
    env = make(3)
    env.set_options([{"length": 2}, {"length": 4}, {"length": 4}])
    env.park_when_done(True)
    env.reset()
    actions = np.full((3, 2), 0.5, np.float32)
    env.step(actions)
    last, _, dones, infos = env.step(actions)
    assert dones.tolist() == [True, False, False]
    assert same(infos[0]["terminal_observation"], last[0])

    obs, rewards, dones, infos = env.step(actions)
    assert infos[0] == {"idle": True}
    assert (rewards[0], dones[0]) == (0.0, False)
    assert np.array_equal(obs[0], last[0])
    assert env.get_attr("n_steps") == [2, 3, 3]  # the idle env did not simulate

    env.assign(0, {"seed": 11, "options": {"length": 3}})
    obs, rewards, dones, infos = env.step(actions)
    expected, _ = RandomWalk().reset(seed=11, options={"length": 3})
    assert np.array_equal(obs[0], expected)  # the action was ignored
    assert (rewards[0], dones[0]) == (0.0, False)
    assert infos[0] == {"length": 3, "episode_start": True}
    assert env.reset_infos[0] == {"length": 3}
    obs, *_ = env.step(actions)
    assert np.allclose(obs[0, :2], expected[:2] + 0.5)
    assert env.get_attr("n_steps") == [3, 4, 4]


def test_an_assignment_interrupts_a_running_episode(make):
    env = make(2)
    env.set_options({"length": 4})
    env.reset()
    env.step(np.zeros((2, 2)))
    env.assign(1, {"options": {"length": 5}})
    *_, infos = env.step(np.zeros((2, 2)))
    assert infos[1]["episode_start"] is True
    assert env.get_attr("age") == [2, 0]


def test_job_mode_needs_no_reset_and_runs_jobs_in_any_env(make):
    env = make(3)
    env.park_when_done(True)
    env.assign(2, {"seed": 5, "options": {"length": 1}})
    *_, infos = env.step(np.zeros((3, 2)))
    assert infos == [{"idle": True}, {"idle": True}, {"length": 1, "episode_start": True}]
    _, _, dones, _ = env.step(np.zeros((3, 2)))
    assert dones.tolist() == [False, False, True]
    assert env.get_attr("n_steps") == [0, 0, 1]


def test_a_vec_env_that_leaves_job_mode_leaves_no_row_idle(make):
    env = make(3)
    env.park_when_done(True)
    env.assign(0, {"options": {"length": 1}})
    env.step(np.zeros((3, 2)))
    env.step(np.zeros((3, 2)))
    env.assign(1, {"options": {"length": 7}})  # never begun
    env.park_when_done(False)
    *_, dones, infos = env.step(np.zeros((3, 2)))
    assert not dones.any()
    assert [info["length"] for info in infos] == [env.reset_infos[i]["length"] for i in range(3)] != [7] * 3
    assert all(info["episode_start"] for info in infos)
    env.assign(2, {"options": {"length": 7}})
    env.reset()
    *_, infos = env.step(np.zeros((3, 2)))
    assert "episode_start" not in infos[2]


def test_rewards_of_job_mode_are_not_rounded(make):
    env = make(2)
    env.park_when_done(True)
    env.assign(0, {"seed": 3, "options": {"length": 5}})
    env.step(np.zeros((2, 2)))
    single = RandomWalk()
    single.reset(seed=3, options={"length": 5})
    action = np.full(2, 0.1, np.float32)
    _, rewards, *_ = env.step(np.stack([action] * 2))
    assert rewards[0] == single.step(action)[1]


def test_without_parking_an_assigned_episode_is_followed_by_an_automatic_reset(make):
    env = make(1)
    env.reset()
    env.assign(0, {"options": {"length": 1}})
    env.step(np.zeros((1, 2)))
    _, _, dones, infos = env.step(np.zeros((1, 2)))
    assert dones[0]
    *_, infos = env.step(np.zeros((1, 2)))
    assert infos[0] == {"age": 1, "TimeLimit.truncated": False}


def test_a_worker_killed_in_a_step_is_named_and_leaves_nothing_behind(make):
    env = make(4, timeout=60.0)
    pids = env.env_method("pid")
    env.reset()
    env.assign(2, with_condition("c0ffee", misfortune="hang"))
    env.step(np.zeros((4, 2)))
    threading.Timer(0.3, os.kill, (pids[2], signal.SIGKILL)).start()
    begin = time.monotonic()
    with pytest.raises(WorkerDied, match=r"Worker 1 died \(killed by SIGKILL.*in env 2.*condition c0ffee") as caught:
        env.step(np.zeros((4, 2)))
    assert time.monotonic() - begin < 5.0
    assert (caught.value.worker, caught.value.env_index, caught.value.condition) == (1, 2, "condition c0ffee")
    with pytest.raises(WorkerDied):
        env.step(np.zeros((4, 2)))
    begin = time.monotonic()
    env.close()
    env.close()
    assert time.monotonic() - begin < 2.0
    assert not any(running(pid) for pid in pids)


def test_a_worker_killed_between_steps_is_reported_with_the_conditions_it_ran(make):
    env = make(2)
    env.set_options([{"condition": SimpleNamespace(id="aa")}, {"condition": SimpleNamespace(id="bb")}])
    env.reset()
    os.kill(env.env_method("pid")[1], signal.SIGKILL)
    with pytest.raises(WorkerDied, match=r"Worker 1 died.*env 1: condition bb"):
        env.step(np.zeros((2, 2)))


def test_an_exception_in_an_env_names_env_and_condition_and_carries_the_traceback(make):
    env = make(4)
    env.reset()
    env.assign(3, with_condition("badbad", misfortune="raise"))
    env.step(np.zeros((4, 2)))
    with pytest.raises(WorkerFailed, match=r"ZeroDivisionError in env 3 of worker 1.*badbad.*wheel fell off") as caught:
        env.step(np.zeros((4, 2)))
    assert (caught.value.worker, caught.value.env_index) == (1, 3)
    assert 'raise ZeroDivisionError("wheel fell off")' in str(caught.value.__cause__)
    env.set_attr("misfortune", "")
    env.env_method("double", 1)  # every worker still answers
    begin = time.monotonic()
    env.close()
    assert time.monotonic() - begin < 2.0


def test_an_env_that_hangs_ends_in_a_named_error_and_a_quick_close(make):
    env = make(2, timeout=0.6)
    pids = env.env_method("pid")
    env.seed(40)
    env.reset()
    env.assign(1, {"seed": 99, "options": {"misfortune": "hang"}})
    env.step(np.zeros((2, 2)))
    begin = time.monotonic()
    with pytest.raises(WorkerDied, match=r"Worker 1 gave no answer for 0.6 s.*in env 1.*seed=99"):
        env.step(np.zeros((2, 2)))
    assert time.monotonic() - begin < 2.0
    begin = time.monotonic()
    env.close()
    assert time.monotonic() - begin < 2.0
    assert not any(running(pid) for pid in pids)


class Slow(RandomWalk):
    def step(self, action):
        time.sleep(0.3)
        return super().step(action)


def test_the_time_limit_is_for_one_env_not_for_a_workers_whole_share(make):
    env = make(4, 1, timeout=0.8, env_class=Slow)
    env.reset()
    env.step(np.zeros((4, 2)))  # 1.2 s in all


def test_close_is_quick_while_an_env_is_in_its_step(make):
    env = make(2)
    pids = env.env_method("pid")
    env.reset()
    env.assign(0, {"options": {"misfortune": "hang"}})
    env.step(np.zeros((2, 2)))
    env.step_async(np.zeros((2, 2)))
    begin = time.monotonic()
    env.close()
    assert time.monotonic() - begin < 2.0
    assert not any(running(pid) for pid in pids)


def test_a_step_cut_short_by_reset_leaves_no_stale_answer(make):
    env = make(2)
    env.reset()
    env.step_async(np.ones((2, 2)))
    env.seed(3)
    first = env.reset()
    assert np.array_equal(first[0], RandomWalk().reset(seed=3)[0])
    assert env.env_method("double", 2) == [4, 4]


class InterruptedPipe:
    """A pipe during whose every call Ctrl-C arrives, once the bytes are through."""

    def __init__(self, pipe):
        self.pipe = pipe

    def __getattr__(self, name):
        return getattr(self.pipe, name)

    def send_bytes(self, message):
        self.pipe.send_bytes(message)
        signal.raise_signal(signal.SIGINT)

    def recv_bytes(self):
        answer = self.pipe.recv_bytes()
        signal.raise_signal(signal.SIGINT)
        return answer


@pytest.fixture
def ctrl_c():
    """Ctrl-C raises KeyboardInterrupt, also where the tests run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_inside_a_message_leaves_no_answer_to_the_wrong_command(make, ctrl_c):
    env = make(2)
    env.reset()
    whole = env._pool._pipes[1]
    for interrupted in (env.reset, lambda: env.step(np.zeros((2, 2))), lambda: env.get_attr("metadata")):
        env._pool._pipes[1] = InterruptedPipe(whole)
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        with pytest.raises(KeyboardInterrupt):
            env._pool.collect()
        env._pool._pipes[1] = whole
        assert env.env_method("double", 1) == [2, 2]
        assert env.reset().shape == (2, *env.observation_space.shape)


def test_dropping_the_env_ends_its_workers(make):
    env = SharedMemoryVecEnv([RandomWalk, RandomWalk])
    pids = env.env_method("pid")
    del env
    assert gone_within(pids, 2.0)


def test_using_a_closed_env_says_so(make):
    env = make(1)
    env.close()
    for call in (env.reset, env.render, lambda: env.step(np.zeros((1, 2)))):
        with pytest.raises(RuntimeError, match="closed"):
            call()


def test_killing_the_parent_leaves_no_worker_even_when_an_env_hangs(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        textwrap.dedent(
            """
            import sys, numpy as np
            sys.path.insert(0, sys.argv[1])
            from test_vector_env import RandomWalk, SharedMemoryVecEnv

            if __name__ == "__main__":
                env = SharedMemoryVecEnv([RandomWalk, RandomWalk])
                env.reset()
                env.assign(0, {"options": {"misfortune": "hang"}})
                env.step(np.zeros((2, 2)))
                print(*env.env_method("pid"), flush=True)
                env.step(np.zeros((2, 2)))
            """
        )
    )
    command = [sys.executable, str(script), os.path.dirname(__file__)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        pids = [int(word) for word in parent.stdout.readline().split()]
        time.sleep(0.2)
        assert len(pids) == 2
        assert all(running(pid) for pid in pids)
        parent.kill()
    assert gone_within(pids, 4.0)


def test_workers_leave_ctrl_c_to_the_parent(make):
    env = make(2)
    for pid in env.env_method("pid"):
        os.kill(pid, signal.SIGINT)
    time.sleep(0.1)
    assert env.env_method("double", 1) == [2, 2]


def test_many_envs_in_a_row_leak_neither_descriptors_nor_processes():
    def cycle():
        env = SharedMemoryVecEnv([RandomWalk])
        env.reset()
        env.close()

    cycle()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        cycle()
    assert len(os.listdir("/proc/self/fd")) <= before
    assert not [child for child in multiprocessing.active_children() if child.name.startswith("env-worker")]


def test_bad_arguments_are_refused_by_name():
    with pytest.raises(ValueError, match="n_envs is 0"):
        SharedMemoryVecEnv([])
    with pytest.raises(ValueError, match="n_workers is 0"):
        SharedMemoryVecEnv([RandomWalk], n_workers=0)
    with pytest.raises(ValueError, match="timeout is 0"):
        SharedMemoryVecEnv([RandomWalk], timeout=0)
    with pytest.raises(TypeError, match=r"env_fns\[1\] is RandomWalk"):
        SharedMemoryVecEnv([RandomWalk, RandomWalk()])
    lock = threading.Lock()
    with pytest.raises(TypeError, match=r"env_fns\[1\] cannot be sent"):
        SharedMemoryVecEnv([RandomWalk, lambda: lock])
    with pytest.raises(ValueError, match="env 2 has observation space"):
        SharedMemoryVecEnv([RandomWalk, RandomWalk, Structured])
    with pytest.raises(WorkerFailed, match=r"TypeError in env 1 .*returned int, expected a gymnasium.Env"):
        SharedMemoryVecEnv([RandomWalk, lambda: 3])


def test_bad_calls_are_refused_by_name(make):
    env = make(2)
    env.reset()
    with pytest.raises(ValueError, match=r"actions have shape \(2, 1\), expected \(2, 2\)"):
        env.step(np.zeros((2, 1)))
    with pytest.raises(IndexError, match="no env 2, expected 0 to 1"):
        env.assign(2, {})


def test_ppo_trains_on_it(make):
    env = make(4)
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(200)
    assert model.num_timesteps >= 200


class BusyLoopEnv(gym.Env):
    """Keeps its core busy for a known time a step."""

    observation_space = gym.spaces.Box(-1, 1, (64,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (7,), np.float32)

    def __init__(self, step_seconds):
        self.step_seconds = step_seconds

    def reset(self, *, seed=None, options=None):
        return np.zeros(64, np.float32), {}

    def step(self, action):
        end = time.perf_counter() + self.step_seconds
        while time.perf_counter() < end:
            pass
        return np.zeros(64, np.float32), 0.0, False, False, {"residual_mask": 1.0, "phase": "close"}

    def processor_time(self):
        return time.process_time()


def measure_overhead(*, n_envs=16, n_workers=2, step_seconds=1e-3, n_steps=150):
    """Compare the vectorised env with a bare loop over the same envs.

    Returns:
        Processor time (main process and workers) a env-step beyond the bare loop's, s; throughput over one env's.
    """
    bare, actions = BusyLoopEnv(step_seconds), np.zeros((n_envs, 7), np.float32)
    begin, processor = time.perf_counter(), time.process_time()
    for k in range(n_steps * n_envs // n_workers):
        bare.step(actions[k % n_envs])
    alone = (time.perf_counter() - begin) / (n_steps * n_envs // n_workers)
    own = (time.process_time() - processor) / (n_steps * n_envs // n_workers)

    env = SharedMemoryVecEnv([lambda: BusyLoopEnv(step_seconds)] * n_envs, n_workers=n_workers)
    one_per_worker = [share.start for share in env._pool.shares]

    def spent():
        return time.process_time() + sum(env.env_method("processor_time", indices=one_per_worker))

    env.reset()
    for _ in range(10):
        env.step(actions)
    processor, begin = spent(), time.perf_counter()
    for _ in range(n_steps):
        env.step(actions)
    wall = (time.perf_counter() - begin) / (n_steps * n_envs)
    overhead = (spent() - processor) / (n_steps * n_envs) - own
    env.close()
    return overhead, alone / wall


@pytest.mark.slow
def test_an_env_step_costs_at_most_20_us_beside_the_envs_own_time():
    overheads = sorted(measure_overhead(step_seconds=2e-4)[0] for _ in range(5))
    assert overheads[2] <= 20e-6, overheads


@pytest.mark.slow
def test_two_workers_give_1_7_times_one_envs_throughput():
    ratios = sorted(measure_overhead(step_seconds=1e-3)[1] for _ in range(5))
    assert ratios[2] >= 1.7, ratios
