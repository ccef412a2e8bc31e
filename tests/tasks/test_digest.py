from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

from dynaforge.tasks import TASK_NAMES, get_task
from dynaforge.tasks.digest import digest_in_any_setting, task_digest

CAN = get_task("can")


def test_tasks_differ_and_every_process_agrees() -> None:
    digests = [task_digest(get_task(name)) for name in TASK_NAMES]
    assert len(set(digests)) == len(TASK_NAMES)
    script = "from dynaforge.tasks import *; from dynaforge.tasks.digest import task_digest\n"
    script += "print(*[task_digest(get_task(name)) for name in TASK_NAMES])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == digests


def test_what_defines_a_task_counts_and_what_describes_it_does_not() -> None:
    phases = (replace(CAN.phases[0], timeout=CAN.phases[0].timeout + 0.1), *CAN.phases[1:])
    assert task_digest(replace(CAN, phases=phases)) != task_digest(CAN)
    assert task_digest(replace(CAN, scene=replace(CAN.scene, physics_dt=1 / 480))) != task_digest(CAN)
    assert task_digest(
        replace(CAN, scene=replace(CAN.scene, launch=lambda c: dict(CAN.scene.launch(c))))
    ) != task_digest(CAN)
    assert task_digest(replace(CAN, motion="It rolls.", camera=((1.0, 0.0, 1.0), (0.0, 0.0, 0.0)))) == task_digest(CAN)
    assert CAN.conditions.units
    assert task_digest(replace(CAN, conditions=replace(CAN.conditions, units={}))) == task_digest(CAN)
    assert task_digest(replace(CAN, instruction="catch it")) == task_digest(CAN)


def test_prediction_in_the_planner_is_another_definition_in_every_setting() -> None:
    led = [replace(CAN, lead_time=seconds) for seconds in (0.0, 0.1, 0.2)]
    assert [task_digest(task) == task_digest(CAN) for task in led] == [True, False, False]
    assert len({digest_in_any_setting(task) for task in led}) == 3


def test_a_longer_history_counts_and_the_usual_one_adds_nothing() -> None:
    with_history = [replace(CAN, residual=replace(CAN.residual, history=n)) for n in (4, 8)]
    assert [task_digest(task) == task_digest(CAN) for task in with_history] == [True, False]


def test_a_setting_changes_the_digest_but_not_that_in_any_setting() -> None:
    others = [CAN.under(reflex=55), CAN.under(physics="wide"), CAN.under(sensing="real")]
    assert len({task_digest(task) for task in (CAN, *others)}) == 4
    assert {digest_in_any_setting(task) for task in (CAN, *others)} == {digest_in_any_setting(CAN)}
    phases = (replace(CAN.phases[0], timeout=CAN.phases[0].timeout + 0.1), *CAN.phases[1:])
    assert digest_in_any_setting(replace(CAN, phases=phases)) != digest_in_any_setting(CAN)


def test_every_task_says_in_words_what_to_do_and_one_of_ones_own_by_default() -> None:
    instructions = [get_task(name).instruction for name in TASK_NAMES]
    assert "pick up the rolling can" in instructions
    assert len(set(instructions)) == len(TASK_NAMES)
    assert replace(get_task("peg"), instruction="").instruction == "grasp and insert the peg"


def test_the_phase_that_plans_contact() -> None:
    named = {name: get_task(name).phases[get_task(name).contact_phase].name for name in TASK_NAMES}
    assert named["can"] == named["lemon"] == named["peg"] == "close"
    assert named["alarmclock"] == "press"
