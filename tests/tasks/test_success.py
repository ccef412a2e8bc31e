from __future__ import annotations

from dataclasses import replace

from hand_made import scene

from dynaforge.tasks import get_task
from dynaforge.tasks.predicates import Lifted
from dynaforge.tasks.success import Hold, SuccessJudge

CAN = get_task("can")
DT = CAN.scene.control_dt


def test_a_hold_starts_again_after_a_break() -> None:
    hold = Hold(replace(CAN.phases[-1], hold=0.1), control_dt=0.05)
    given = [False, True, True, False, True, True, True, True]
    assert [hold.push(done) for done in given] == [False, False, False, False, False, False, True, True]


def test_success_is_judged_from_the_start_and_over_its_hold() -> None:
    """The can is 10 cm above where it started, whatever that height was, for 0.25 s: the ninth state of 1/30 s."""
    task = replace(CAN, phases=(*CAN.phases[:-1], replace(CAN.phases[-1], done=Lifted("can", 0.1))))
    judge = SuccessJudge(task, scene((0.5, 0.0, 0.2)))
    assert not any(judge.push(scene((0.5, 0.0, 0.29))) for _ in range(20))
    lifted = [judge.push(scene((0.5, 0.0, 0.31), time=k * DT)) for k in range(10)]
    assert lifted == [False] * 8 + [True] * 2
    assert judge.view.state.time == 9 * DT
