from __future__ import annotations

from dynaforge.benchmarks import determinism as bench_determinism
from dynaforge.benchmarks.episodes import (
    TrajectoryHash,
    bench_conditions,
    hashes_over_histories,
    run_planner_only,
    run_zero_residual,
)
from dynaforge.envs.residual import ResidualScale
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import World
from dynaforge.sim import SimScene
from dynaforge.tasks import get_task

CAN = get_task("can")


def test_zero_residual_equals_planner_only_bit_for_bit():
    (figure,) = bench_determinism.zero_residual(CAN, n=2)
    assert figure.ok, figure


def test_a_residual_of_a_nanometre_is_noticed(monkeypatch):
    exact = ResidualScale.physical
    monkeypatch.setattr(ResidualScale, "physical", lambda *given: exact(*given) + 1e-9)
    (figure,) = bench_determinism.zero_residual(CAN, n=1)
    assert not figure.ok
    assert figure.measured.startswith("0 of 1")


def test_six_histories_leave_one_hash_and_a_reset_that_keeps_joint_velocities_is_noticed(monkeypatch):
    condition = bench_conditions(CAN, 10)[9]
    (hashes,) = hashes_over_histories("can", [condition])
    assert len(hashes) == 6
    assert len(set(hashes.values())) == 1
    exact = SimScene.reset

    def teleport(scene, condition, **options):
        bullet, before = scene._bullet, scene.observe().dq.tolist()
        exact(scene, condition, **options)
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
