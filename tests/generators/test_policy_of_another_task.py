from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import make_generator
from dynaforge.tasks import TASK_NAMES, Task, get_task
from dynaforge.tasks.digest import definition_of

CAN = get_task("can")


def policy_of(task: Task, path: Path, **meta: object) -> Path:
    inputs, outputs = ResidualEnv.sizes(task)
    layer = (np.zeros((outputs, inputs), np.float32), np.zeros(outputs, np.float32))
    MlpPolicyFile([layer], "Tanh", task=task.name, meta=definition_of(task) | meta).save(path)
    return path


def test_a_policy_of_this_very_task_is_taken(tmp_path: Path) -> None:
    make_generator("residual", CAN, policy=policy_of(CAN, tmp_path / "p"))


@pytest.mark.parametrize("task", TASK_NAMES)
def test_a_shipped_policy_of_the_older_physics_is_refused_with_the_remedy(task: str) -> None:
    with pytest.raises(ValueError) as refused:
        make_generator("residual", get_task(task))
    assert str(refused.value) == (
        f"The shipped policy of {task!r} was trained for another definition of the task (rigid arm, no force reflex), "
        f"so it is not used. Use --generator planner_only, or train one: dynaforge forge --task {task}."
    )


@pytest.mark.parametrize("change", [{"reflex": "strict"}, {"reflex": 55}, {"physics": "fixed"}, {"sensing": "real"}])
def test_a_policy_of_another_setting_is_refused_by_the_names_of_both(change: dict, tmp_path: Path) -> None:
    other = CAN.under(**change)
    path = policy_of(other, tmp_path / "p")
    with pytest.raises(ValueError) as refused:
        make_generator("exploring", CAN, policy=path)
    assert f"{path} was trained under another setting ({other.setting}) than this one ({CAN.setting})" in str(
        refused.value
    )
    assert "\n" not in str(refused.value)
    make_generator("exploring", other, policy=path)


def test_a_policy_of_another_residual_is_refused(tmp_path: Path) -> None:
    other = replace(CAN, residual=replace(CAN.residual, frame="world"))
    assert other.residual.frame != CAN.residual.frame
    with pytest.raises(ValueError, match="another definition of the task"):
        make_generator("residual", CAN, policy=policy_of(other, tmp_path / "p"))


@pytest.mark.parametrize("setting", [None, 3, {"reflex": "never"}, {"reflex": 1, "physics": [], "sensing": {}}])
def test_a_damaged_setting_is_refused_in_one_line(setting: object, tmp_path: Path) -> None:
    path = policy_of(CAN, tmp_path / "p", task_definition=["0"], setting=setting)
    with pytest.raises(ValueError, match="its setting is unreadable") as refused:
        make_generator("residual", CAN, policy=path)
    assert "\n" not in str(refused.value)
