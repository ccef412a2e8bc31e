from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import make_generator
from dynaforge.generators.by_name import setting_line
from dynaforge.tasks import TASK_NAMES, Task, get_task
from dynaforge.tasks.digest import definition_of

CAN = get_task("can")


def policy_of(task: Task, path: Path, **meta: object) -> Path:
    return policy_with(definition_of(task) | meta, task, path)


def policy_with(meta: dict[str, object], task: Task, path: Path) -> Path:
    inputs, outputs = ResidualEnv.sizes(task)
    layer = (np.zeros((outputs, inputs), np.float32), np.zeros(outputs, np.float32))
    MlpPolicyFile([layer], "Tanh", task=task.name, meta=meta).save(path)
    return path


def test_a_policy_of_this_very_task_is_taken(tmp_path: Path) -> None:
    make_generator("residual", CAN, policy=policy_of(CAN, tmp_path / "p"))


@pytest.mark.parametrize("task", TASK_NAMES)
def test_a_policy_is_shipped_for_each_task_as_it_is_now(task: str) -> None:
    make_generator("residual", get_task(task))


def test_a_policy_that_tells_no_setting_is_refused_as_of_the_older_physics_with_the_remedy(tmp_path: Path) -> None:
    path = policy_with({"task_definition": "0123456789abcdef"}, CAN, tmp_path / "p")
    with pytest.raises(ValueError) as refused:
        make_generator("residual", CAN, policy=path)
    assert str(refused.value) == (
        f"{path} was trained for another definition of the task (rigid arm, no force reflex), "
        "so it is not used. Use --generator planner_only, or train one: dynaforge forge --task can."
    )


@pytest.mark.parametrize(
    ("change", "flags"),
    [
        ({"reflex": "strict"}, "Give --reflex strict to run it as it was trained, or --reflex contact to run it"),
        ({"reflex": 55}, "Give --reflex 55 to"),
        ({"physics": "fixed", "sensing": "real"}, "Give --physics fixed --sensing real to"),
    ],
)
def test_a_policy_of_another_setting_is_refused_by_the_names_of_both(change: dict, flags: str, tmp_path: Path) -> None:
    other = CAN.under(**change)
    path = policy_of(other, tmp_path / "p")
    for chosen in ([], list(change)[1:]):
        with pytest.raises(ValueError) as refused:
            make_generator("exploring", CAN, policy=path, chosen=chosen)
        message = str(refused.value)
        assert f"{path} was trained under another setting ({other.setting}) than this one ({CAN.setting})" in message
        assert "\n" not in message
    make_generator("exploring", other, policy=path)
    with pytest.raises(ValueError) as refused:
        make_generator("exploring", CAN, policy=path)
    assert flags in str(refused.value)


def test_a_policy_is_tried_under_another_setting_where_that_is_chosen(tmp_path: Path) -> None:
    path = policy_of(CAN, tmp_path / "p")
    held_out = CAN.under(physics="wide:hand_delay", reflex="strict")
    generators = [
        make_generator(name, held_out, policy=path, chosen=["physics", "reflex"])
        for name in ("planner_only", "residual", "exploring")
    ]
    assert setting_line(held_out, generators) == (
        "trained under reflex contact, physics varied, sensing ideal; "
        "run under reflex strict, physics wide:hand_delay, sensing ideal"
    )
    for generator in generators[1:]:
        assert generator.policy_origin["trained_under"] == CAN.setting.to_dict()
        assert generator.policy_origin["policy"] == MlpPolicyFile.load(path).digest
    assert setting_line(held_out, generators[:1]) == "reflex strict, physics wide:hand_delay, sensing ideal"
    same = [make_generator("residual", CAN, policy=path)]
    assert setting_line(CAN, same) == "reflex contact, physics varied, sensing ideal"


def test_a_policy_of_another_task_is_refused_under_a_chosen_setting_too(tmp_path: Path) -> None:
    other = replace(CAN, residual=replace(CAN.residual, frame="world"))
    with pytest.raises(ValueError, match="for another definition of the task"):
        make_generator(
            "residual", CAN.under(physics="wide"), policy=policy_of(other, tmp_path / "p"), chosen=["physics"]
        )


def test_a_policy_trained_under_other_ranges_of_the_same_name_is_refused(tmp_path: Path) -> None:
    path = policy_of(CAN, tmp_path / "p", task_definition="of other ranges")
    with pytest.raises(ValueError, match="for another definition of the task"):
        make_generator("residual", CAN, policy=path, chosen=["physics"])


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
