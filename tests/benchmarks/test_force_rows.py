from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynaforge.benchmarks import forces as bench_forces
from dynaforge.sim.force_watch import ForceWatch
from dynaforge.sim.reflex import THRESHOLDS, thresholds
from dynaforge.sim.robot import franka
from dynaforge.tasks import get_task

CAN = get_task("can")


def test_an_arm_that_yields_meets_the_figure_and_a_rigid_one_misses_it(monkeypatch):
    pressing, _ = bench_forces.peak_force(CAN, n=1)
    assert pressing.ok, pressing
    assert min(pressing.raw["steady_newtons"]) > 5.0
    rigid = replace(franka(), torque_margin=np.full(7, 80.0))
    monkeypatch.setattr("dynaforge.sim.scene.franka", lambda: rigid)
    pressing, _ = bench_forces.peak_force(CAN, n=1)
    assert not pressing.ok
    assert max(pressing.raw["steady_newtons"]) > 150.0


def test_planned_successes_that_press_too_hard_are_noticed(monkeypatch):
    slow = [CAN.conditions.draw(np.random.default_rng(seed), 0, 10) for seed in range(2)]
    monkeypatch.setattr(bench_forces, "bench_conditions", lambda task, n: slow)
    _, planned = bench_forces.peak_force(CAN, n=2)
    assert planned.ok, planned
    lasting, peaks = planned.raw["lasting_newtons"], planned.raw["peak_newtons"]
    assert lasting
    assert all(mean <= peak for mean, peak in zip(lasting, peaks, strict=True))
    softer = {"contact": replace(THRESHOLDS["contact"], force=0.5 * max(lasting))}
    monkeypatch.setattr(bench_forces, "THRESHOLDS", softer)
    assert not bench_forces.peak_force(CAN, n=2)[1].ok


@pytest.mark.parametrize("reflex", ["off", 40.0])
def test_a_reflex_that_acts_never_or_too_soon_is_noticed(monkeypatch, reflex):
    watching, stopping = bench_forces.reflex(CAN, rounds=1, n=1)
    assert len(watching.raw["shares"]) == 1
    assert stopping.ok, stopping
    assert stopping.raw["200 N"]["newtons"] > 150.0
    monkeypatch.setattr("dynaforge.sim.scene.thresholds", lambda name: thresholds(reflex))
    assert not bench_forces.reflex(CAN, rounds=1, n=1)[1].ok


def test_a_watch_that_costs_too_much_is_noticed(monkeypatch):
    see = ForceWatch.see

    def slow_see(watch, contacts):
        sum(range(10_000))
        see(watch, contacts)

    monkeypatch.setattr(ForceWatch, "see", slow_see)
    assert not bench_forces.reflex(CAN, rounds=1, n=1)[0].ok
