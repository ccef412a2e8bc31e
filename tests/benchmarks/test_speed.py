from __future__ import annotations

from dataclasses import replace

from dynaforge.benchmarks import determinism as bench_determinism
from dynaforge.benchmarks import speed as bench_speed
from dynaforge.tasks import get_task

CAN = get_task("can")


def test_bench_works_where_fixtures_move_and_there_is_no_free_body():
    clock = get_task("alarmclock")
    (figure,) = bench_determinism.zero_residual(clock, n=1)
    assert figure.ok, figure
    (figure,) = bench_speed.control_rate(clock, rounds=1, n=1)
    assert figure.raw["replays_astray"] == 0


def test_resets_are_timed_and_a_slow_one_misses_the_figure(monkeypatch):
    (figure,) = bench_speed.scene_reset(CAN, rounds=2, n=4)
    assert [len(values) for values in figure.raw["cpu_seconds"]] == [4, 4]
    assert all(value > 0 for values in figure.raw["cpu_seconds"] for value in values)
    monkeypatch.setattr(bench_speed, "MAX_RESET_SECONDS", 1e-6)
    assert not bench_speed.scene_reset(CAN, rounds=1, n=1)[0].ok


def test_the_bare_loop_simulates_the_very_same_episodes_in_less_time():
    (figure,) = bench_speed.control_rate(CAN, rounds=1, n=2)
    assert figure.raw["replays_astray"] == 0
    assert 0.2 < figure.raw["ratio"][0] < 1.0
    assert figure.raw["control_steps"] > 40


def test_the_plain_figure_watches_no_forces(monkeypatch):
    seen, run = [], bench_speed.run_zero_residual

    def noted(env, condition):
        outcome = run(env, condition)
        seen.append((env.task.setting.reflex, env.task.setting.physics, env.world.scene.loads.peak_force))
        return outcome

    monkeypatch.setattr(bench_speed, "run_zero_residual", noted)
    (figure,) = bench_speed.control_rate(CAN, rounds=1, n=4, plain=True)
    assert figure.raw["replays_astray"] == 0
    assert set(seen) == {("off", "fixed", 0.0)}
    seen.clear()
    bench_speed.control_rate(CAN, rounds=1, n=4)
    assert {each[:2] for each in seen} == {("contact", "varied")}
    assert max(force for *_, force in seen) > 0.0


def test_a_bare_loop_on_another_trajectory_misses_the_figure(monkeypatch):
    record = bench_speed._record

    def shifted(env, condition):
        recording = record(env, condition)
        return replace(recording, commands=recording.commands[:-1])

    monkeypatch.setattr(bench_speed, "_record", shifted)
    (figure,) = bench_speed.control_rate(CAN, rounds=1, n=1)
    assert not figure.ok
    assert "1 replays left the recorded trajectory" in figure.measured


def test_every_global_plan_is_timed_and_a_slow_one_is_noticed(monkeypatch):
    (figure,) = bench_speed.global_plans(get_task("can"), n=1)
    assert len(figure.raw["cpu_seconds"]) == 1
    monkeypatch.setattr(bench_speed, "MAX_PLAN_SECONDS", 1e-6)
    (figure,) = bench_speed.global_plans(get_task("can"), n=1)
    assert not figure.ok
