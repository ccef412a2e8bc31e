from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest

from dynaforge.benchmarks import data as bench_data
from dynaforge.benchmarks import determinism as bench_determinism
from dynaforge.benchmarks import limits as bench_limits
from dynaforge.benchmarks import speed as bench_speed
from dynaforge.benchmarks import training as bench_training
from dynaforge.benchmarks import vector as bench_vector
from dynaforge.benchmarks.episodes import (
    BusyLoopEnv,
    TrajectoryHash,
    bench_conditions,
    hashes_over_histories,
    run_planner_only,
    run_zero_residual,
)
from dynaforge.benchmarks.figure import Figure
from dynaforge.cli import bench
from dynaforge.cli.main import main
from dynaforge.envs.residual import ResidualScale
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import World
from dynaforge.geometry import JointTrajectory, Pose
from dynaforge.planning import ArmKinematics, CollisionModel, Obstacle
from dynaforge.sampling.vector_env import SharedMemoryVecEnv
from dynaforge.sim import SimScene
from dynaforge.sim.robot import franka
from dynaforge.tasks import TASK_NAMES, get_task

CAN = get_task("can")


@pytest.fixture
def found(monkeypatch):
    """Let `dynaforge bench` find these figures instead of measuring."""
    figures = {"light": Figure("lightness", "<= 1 kg", "0.5 kg", True, {"rounds": [0.5]})}
    monkeypatch.setattr(bench, "MEASUREMENTS", {n: lambda task, rounds, n=n: [figures[n]] for n in ("light", "tall")})
    figures["tall"] = replace(figures["light"], title="height", ok=True)
    return figures


def test_bench_ends_with_0_when_every_figure_is_met_and_with_1_when_one_is_missed(found, capsys):
    assert main(["bench"]) == 0
    assert "| lightness | <= 1 kg | 0.5 kg | yes |" in capsys.readouterr().out
    found["tall"] = replace(found["tall"], ok=False)
    assert main(["bench"]) == 1
    out = capsys.readouterr().out
    assert "| height | <= 1 kg | 0.5 kg | NO |" in out
    assert "missed: tall" in out
    assert main(["bench", "--only", "light"]) == 0


def test_what_takes_long_is_measured_only_when_named(found, monkeypatch, capsys):
    monkeypatch.setattr(bench, "LONG", {"tall"})
    assert main(["bench"]) == 0
    assert "height" not in capsys.readouterr().out
    assert main(["bench", "--only", "tall"]) == 0
    assert "height" in capsys.readouterr().out


def test_the_record_holds_command_machine_versions_and_rounds(found, tmp_path):
    out = tmp_path / "new" / "bench.json"
    assert main(["bench", "--rounds", "3", "--out", str(out)]) == 0
    record = json.loads(out.read_text())
    assert record["rounds"] == 3
    assert record["machine"]["cores"] >= 1
    assert record["machine"]["cpu"]
    assert {"pybullet", "numpy"} <= set(record["versions"])
    assert record["figures"]["light"][0]["raw"] == {"rounds": [0.5]}
    assert record["command"].startswith("dynaforge")
    assert record["date"].endswith("UTC")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--only", "lihgt"], "Did you mean 'light'?"),
        (["--rounds", "0"], "--rounds is 0"),
        (["--task", "cann"], "Did you mean 'can'?"),
        (["--out", "."], "is a folder"),
    ],
)
def test_a_mistake_is_named_in_one_line_before_anything_is_measured(found, capsys, arguments, words):
    found.clear()
    assert main(["bench", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_record_that_cannot_be_written_is_refused_before_anything_is_measured(found, capsys, tmp_path):
    found.clear()
    (tmp_path / "file").write_text("")
    assert main(["bench", "--out", str(tmp_path / "file" / "bench.json")]) == 2
    assert "file" in capsys.readouterr().err


def test_finger_speed_is_measured_over_full_strokes_and_a_faster_motor_is_seen(monkeypatch):
    (figure,) = bench_limits.finger_speed(CAN)
    assert figure.ok, figure
    assert all(0.045 < speed <= 0.05 for speed in figure.raw["metres_per_second"].values())
    monkeypatch.setattr("dynaforge.sim.scene.FINGER_SPEED_MARGIN", 1.2)
    (figure,) = bench_limits.finger_speed(CAN)
    assert not figure.ok
    assert figure.raw["metres_per_second"]["at once"] == pytest.approx(0.06, rel=0.02)


def test_zero_residual_equals_planner_only_bit_for_bit():
    (figure,) = bench_determinism.zero_residual(CAN, n=2)
    assert figure.ok, figure


def test_bench_holds_where_fixtures_move_and_there_is_no_free_body():
    clock = get_task("alarmclock")
    (figure,) = bench_determinism.zero_residual(clock, n=1)
    assert figure.ok, figure
    (figure,) = bench_speed.control_rate(clock, rounds=1, n=1)
    assert figure.raw["replays_astray"] == 0


QUICK = {
    "finger-speed": lambda task: bench_limits.finger_speed(task),
    "zero-residual": lambda task: bench_determinism.zero_residual(task, n=2),
    "one-trajectory": lambda task: bench_determinism.one_trajectory(task, n=1, sizes=(2,)),
    "reset": lambda task: bench_speed.scene_reset(task, rounds=1, n=2),
    "control-steps": lambda task: bench_speed.control_rate(task, rounds=1, n=2),
    "vectorised": lambda task: bench_vector.vectorised(task, rounds=1, n_envs=2, n_steps=10),
    "trainer": lambda task: bench_training.trainer(task, rounds=1),
    "collection": lambda task: bench_training.collection(task, rounds=1),
    "writing": lambda task: bench_data.writing(task, rounds=1),
    "window": lambda task: bench_data.window(rounds=1),
    "replay": lambda task: bench_data.replay(task),
    "worker-killed": lambda task: bench_vector.worker_killed(task, rounds=1, n_envs=2),
    "global-planner": lambda task: bench_limits.global_planner(task, n=2),
}
EXACT = ("zero-residual", "one-trajectory", "replay")  # whatever else runs on this machine


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", TASK_NAMES)
def test_every_row_is_measured_on_every_task(name, monkeypatch):
    assert set(QUICK) == set(bench.MEASUREMENTS) - bench.LONG
    for constant, value in (("ATTEMPTS", 6), ("REPLAYED", 4), ("PACKED", 5), ("WINDOWS", 100)):
        monkeypatch.setattr(bench_data, constant, value)
    task = get_task(name)
    for row, measure in QUICK.items():
        for figure in measure(task):
            assert figure.measured
            assert figure.ok or row not in EXACT, figure
            assert figure.raw.get("replays_astray", 0) == 0, figure


def test_a_residual_of_a_nanometre_is_seen(monkeypatch):
    exact = ResidualScale.physical
    monkeypatch.setattr(ResidualScale, "physical", lambda *given: exact(*given) + 1e-9)
    (figure,) = bench_determinism.zero_residual(CAN, n=1)
    assert not figure.ok
    assert figure.measured.startswith("0 of 1")


def test_six_histories_leave_one_hash_and_a_reset_that_keeps_joint_velocities_is_seen(monkeypatch):
    condition = bench_conditions(CAN, 10)[9]
    (hashes,) = hashes_over_histories("can", [condition])
    assert len(hashes) == 6
    assert len(set(hashes.values())) == 1
    exact = SimScene.reset

    def teleport(scene, condition):
        bullet, before = scene._bullet, scene.observe().dq.tolist()
        exact(scene, condition)
        for joint, q, speed in zip(bullet.robot.arm, scene.robot.q_ready.tolist(), before, strict=True):
            bullet.client.resetJointState(bullet.robot.body, joint, q, speed)
        return scene.observe()

    monkeypatch.setattr(SimScene, "reset", teleport)
    (hashes,) = hashes_over_histories("can", [condition])
    assert len(set(hashes.values())) > 1


def test_one_trajectory_in_every_env_of_a_vectorised_one():
    condition = bench_conditions(CAN, 10)[9]
    ((one,),) = bench_determinism.hashes_in_vector("can", [condition], n_envs=1)
    (here,) = hashes_over_histories("can", [condition])
    assert one == here["nothing"]


def test_planner_only_needs_no_env():
    world, env = World(CAN), ResidualEnv(CAN)
    condition = bench_conditions(CAN, 10)[9]
    hashes = []
    for owner, run in ((world, lambda: run_planner_only(world, env.executor, condition)), (env.world, None)):
        watch = TrajectoryHash()
        owner.listeners.append(watch)
        outcome = run() if run else run_zero_residual(env, condition)
        hashes.append(watch.value(outcome))
    assert hashes[0] == hashes[1]
    world.close()
    env.close()


def test_resets_are_timed_and_a_slow_one_misses_the_figure(monkeypatch):
    (figure,) = bench_speed.scene_reset(CAN, rounds=2, n=4)
    assert [len(values) for values in figure.raw["cpu_seconds"]] == [4, 4]
    assert all(value > 0 for values in figure.raw["cpu_seconds"] for value in values)
    monkeypatch.setattr(bench_speed, "RESET_LIMIT", 1e-6)
    assert not bench_speed.scene_reset(CAN, rounds=1, n=1)[0].ok


def test_the_bare_loop_simulates_the_very_same_episodes_in_less_time():
    (figure,) = bench_speed.control_rate(CAN, rounds=1, n=2)
    assert figure.raw["replays_astray"] == 0
    assert 0.2 < figure.raw["ratio"][0] < 1.0
    assert figure.raw["control_steps"] > 40


def test_a_bare_loop_on_another_trajectory_misses_the_figure(monkeypatch):
    record = bench_speed._record

    def shifted(env, condition):
        recording = record(env, condition)
        return replace(recording, commands=recording.commands[:-1])

    monkeypatch.setattr(bench_speed, "_record", shifted)
    (figure,) = bench_speed.control_rate(CAN, rounds=1, n=1)
    assert not figure.ok
    assert "1 replays left the recorded trajectory" in figure.measured


def test_the_global_planner_is_checked_in_episodes_and_to_random_goals():
    (figure,) = bench_limits.global_planner(CAN, n=3)
    assert figure.ok, figure
    assert {name: part["outside"] for name, part in figure.raw.items()} == {
        "episodes": 0, "bare table": 0, "furnished table": 0,
    }  # fmt: skip
    assert figure.raw["episodes"]["trajectories"] >= 3


def straight(q0, q1, seconds, *, dt=0.1):
    """A joint line at constant speed, hand-worked: slopes (q1 - q0) / seconds, no acceleration."""
    n = round(seconds / dt)
    q = q0 + np.linspace(0, 1, n + 1)[:, None] * (q1 - q0)
    return JointTrajectory(dt, q, np.tile((q1 - q0) / seconds, (n + 1, 1)), np.zeros((n + 1, 7)))


def test_every_kind_of_excess_of_a_trajectory_is_seen():
    robot = franka()
    collision, ready = CollisionModel(robot), robot.q_ready
    turn = np.eye(7)[0]
    calm = bench_limits.examine(straight(ready, ready + 1.31 * turn, 1.0), robot, collision)
    assert calm.inside
    assert calm.velocity == pytest.approx(0.5)  # 1.31 of 2.62 rad/s
    assert calm.position == pytest.approx(-0.8421)  # joint 4 is nearest its limit: -2.2 of -3.0421 rad
    fast = straight(ready, ready + 1.31 * turn, 0.4)
    assert bench_limits.examine(fast, robot, collision).velocity == pytest.approx(1.25)
    quiet = replace(fast, dq=0.0 * fast.dq)  # claims to stand, and moves
    assert not bench_limits.examine(quiet, robot, collision).inside
    jump = replace(fast, dq=np.where(np.arange(5)[:, None] < 2, 0.0, 2.0 * turn))  # 2 rad/s in 0.1 s, of 10 rad/s^2
    assert bench_limits.examine(jump, robot, collision).acceleration == pytest.approx(2.0)
    beyond = bench_limits.examine(straight(ready, ready + 3.0 * turn, 3.0), robot, collision)
    assert beyond.position == pytest.approx(3.0 - 2.7437)
    down = ready + np.array((0, 1.2, 0, 0.6, 0, 0, 0))  # stretches the arm through the table
    through = bench_limits.examine(straight(ready, down, 3.0), robot, collision)
    assert through.collisions > 0
    assert not through.started_in_collision
    assert not through.inside


def test_a_hit_between_two_free_samples_is_seen():
    robot = franka()
    x, y, _ = ArmKinematics(robot).forward(robot.q_ready).position
    post = Obstacle("post", "cylinder", (0.02, 2.0), Pose(np.eye(3), np.array((x, y, 1.0))))
    collision = CollisionModel(robot, fixtures=(post,))
    low, high = robot.q_ready - np.eye(7)[0], robot.q_ready + np.eye(7)[0]
    assert not collision.in_collision(low)
    assert not collision.in_collision(high)
    swing = straight(low, high, 2.0, dt=2.0)  # two samples, the post between them
    assert bench_limits.examine(swing, robot, collision).collisions > 0


def test_what_vectorising_wastes_is_what_the_overhead_says(monkeypatch):
    step = SharedMemoryVecEnv.step

    def wasteful(env, actions):
        end = time.thread_time() + 2e-3
        while time.thread_time() < end:
            pass
        return step(env, actions)

    monkeypatch.setattr(SharedMemoryVecEnv, "step", wasteful)
    overheads, gains = bench_vector.compare(lambda: BusyLoopEnv(1e-4), "test", 2, 2, 1, 10)
    assert len(overheads) == len(gains) == 2
    assert all(1e-3 <= value < 2e-3 for value in overheads)  # 2 ms a step of two envs, and its own cost
    assert all(value > 0.0 for value in gains)


def test_a_killed_worker_is_reported_with_its_name_and_leaves_nothing_behind():
    (figure,) = bench_vector.worker_killed(CAN, rounds=1, n_envs=2)
    assert figure.ok, figure
    assert "condition" in figure.raw["kills"][0]["error"]


@pytest.mark.slow
def test_the_trainer_is_measured_against_ppo_on_equal_transitions() -> None:
    (figure,) = bench_training.trainer(CAN, rounds=1)
    seconds = figure.raw["cpu_seconds"]
    assert len(seconds["frontier_grpo"]) == len(seconds["ppo"]) == 2
    assert all(0 < value < 1e-3 for row in seconds.values() for value in row)


def test_a_timed_env_counts_its_steps_alone() -> None:
    env = bench_training.TimedEnv("can")
    env.reset(seed=0)
    assert env.cpu == 0.0
    start = time.process_time()
    env.step(np.zeros(env.action_space.shape, np.float32))
    assert 0.0 < env.cpu <= time.process_time() - start
    env.close()
