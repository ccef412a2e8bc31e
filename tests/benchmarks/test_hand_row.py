from __future__ import annotations

import pytest

from dynaforge.benchmarks import hand as bench_hand
from dynaforge.sim.hand import GEAR, Hand
from dynaforge.tasks import get_task

CAN = get_task("can")


def test_finger_speed_is_measured_over_full_strokes_and_a_faster_motor_is_noticed(monkeypatch):
    (figure,) = bench_hand.finger_speed(CAN)
    assert figure.ok, figure
    assert all(0.045 < speed <= 0.05 for speed in figure.raw["metres_per_second"].values())
    monkeypatch.setattr("dynaforge.sim.hand.SPEED_MARGIN", 1.2)
    (figure,) = bench_hand.finger_speed(CAN)
    assert not figure.ok
    assert figure.raw["metres_per_second"]["at once"] == pytest.approx(0.06, rel=0.02)


def test_a_hand_that_gives_way_and_fingers_that_drift_apart_are_noticed(monkeypatch):
    held, symmetric = bench_hand.hand(CAN, n=1)
    assert held.ok, held
    assert symmetric.ok, symmetric
    assert symmetric.raw["episodes_metres"] > 0.0
    command = Hand.command
    free = (0.0, 0.04)  # no joint limits that hold the fingers
    monkeypatch.setattr(
        Hand, "command", lambda hand, told: command(hand, told._replace(lower=free[:1] * 2, upper=free[1:] * 2))
    )
    monkeypatch.setitem(GEAR, "maxForce", 5.0)
    held, symmetric = bench_hand.hand(CAN, n=1)
    assert not held.ok
    assert not symmetric.ok
