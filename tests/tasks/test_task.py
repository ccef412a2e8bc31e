"""What every task of the vocabulary must be."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from dynaforge.registration import ENV_NAMES
from dynaforge.tasks import TASK_NAMES, Mode, Task, get_task


@pytest.fixture(params=TASK_NAMES)
def task(request: pytest.FixtureRequest) -> Task:
    return get_task(request.param)


def test_a_task_is_found_under_its_name(task: Task) -> None:
    assert get_task(task.name) is task
    assert ENV_NAMES[task.name] == task.env_name
    assert task.conditions.task == task.name


def test_a_misspelt_task_is_refused_with_the_close_match() -> None:
    with pytest.raises(ValueError, match=r"No task 'cann'\. Did you mean 'can'\?"):
        get_task("cann")


def test_an_unknown_task_is_refused_with_all_names() -> None:
    with pytest.raises(ValueError, match=r"No task 'zebra'\. Known tasks are can"):
        get_task("zebra")


def test_a_task_survives_pickling(task: Task) -> None:
    assert pickle.loads(pickle.dumps(task)) == task


def test_a_condition_of_the_task_survives_pickling(task: Task) -> None:
    condition = task.conditions.draw(np.random.default_rng(0))
    copy = pickle.loads(pickle.dumps(condition))
    assert copy == condition
    assert copy.id == condition.id


def test_the_phase_program_is_complete(task: Task) -> None:
    objects = {item.name for item in (*task.scene.bodies, *task.scene.fixtures)}
    names = [phase.name for phase in task.phases]
    assert len(set(names)) == len(names) == task.n_checkpoints
    for phase in task.phases:
        assert phase.timeout > phase.hold
        assert phase.failure
        assert 0.0 <= phase.width <= 0.08
        assert phase.target.object in objects
    assert task.time_limit == pytest.approx(sum(phase.timeout for phase in task.phases))


def test_the_residual_acts_only_where_ik_tracks(task: Task) -> None:
    """A global phase follows its trajectory verbatim: an open gate there would promise an effect that is none."""
    assert any(phase.gate for phase in task.phases)
    for phase in task.phases:
        if phase.gate:
            assert phase.mode is Mode.IK


def test_success_is_held_for_a_quarter_of_a_second(task: Task) -> None:
    """A click is over as soon as it is done; every other success must last."""
    assert task.phases[-1].hold >= 0.25 or task.skill == "click"


def test_a_control_step_is_a_whole_number_of_substeps(task: Task) -> None:
    assert task.scene.substeps * task.scene.physics_dt == pytest.approx(task.scene.control_dt)


def test_the_residual_has_seven_scales_and_at_least_one_is_on(task: Task) -> None:
    assert len(task.residual.scales) == 7
    assert all(scale >= 0.0 for scale in task.residual.scales)
    assert any(task.residual.scales)
    assert task.residual.decision_steps >= 1


def test_every_reason_why_success_is_impossible_has_words(task: Task) -> None:
    assert all(reason for reason, _ in task.impossible)
