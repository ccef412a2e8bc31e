"""The setting that demonstrations were made under goes with their folder, to every command that reads it."""

from __future__ import annotations

import itertools
import json
import re
from argparse import Namespace
from pathlib import Path

import gymnasium as gym
import pytest

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.exporters.frames import env_arguments_of, env_of
from dynaforge.demos.provenance import Provenance
from dynaforge.sim.reflex import REFLEX_NAMES
from dynaforge.sim.setting import PHYSICS, SENSINGS, Setting
from dynaforge.tasks import Task, get_task
from dynaforge.tasks.action import ActionLayout
from dynaforge.tasks.digest import task_digest

COLLECT = ["collect", "--task", "can", "--generator", "planner_only", "--attempts", "1", "--keep-failures"]
UNDER = {
    "the task's own": [],
    "reflex": ["--reflex", "strict"],
    "fixed": ["--physics", "fixed"],
    "wide": ["--physics", "wide"],
    "all": ["--reflex", "37.5", "--physics", "wide:joint_gain", "--sensing", "real"],
}


def opened(folder: Path) -> Task:
    return open_dataset(Namespace(folder=folder, task_file=None))[1]


def collected(folder: Path, *flags: str) -> int:
    return main([*COLLECT, "--workers", "1", "--out", str(folder), *flags])


def test_a_dataset_of_any_setting_is_opened_in_it(tmp_path: Path) -> None:
    can = get_task("can")
    reflexes = itertools.cycle((*REFLEX_NAMES, 37.5))
    for k, (physics, sensing, reflex) in enumerate(
        (*each, next(reflexes)) for each in itertools.product(PHYSICS, SENSINGS)
    ):
        if physics == "wide:mass":  # the mass of the can is a field of its own
            continue
        setting = Setting(reflex=reflex, physics=physics, sensing=sensing)
        task = can.under(**setting.to_dict())
        dataset = DemonstrationDataset(tmp_path / str(k), task="can")
        dataset.note_source("residual", Provenance("p", task_digest(task), setting=setting))
        assert dataset.sources()["residual"].setting == setting
        assert opened(dataset.path).setting == setting
        assert task_digest(opened(dataset.path)) == task_digest(task)


@pytest.mark.parametrize("name", UNDER)
def test_what_is_collected_under_a_setting_passes_every_check_and_says_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert collected(tmp_path / "data", *UNDER[name]) == 0
    task = opened(tmp_path / "data")
    assert f"can: {task.setting}" in capsys.readouterr().out
    replay = ["--replay"] if name in ("wide", "all") else []
    assert main(["verify", str(tmp_path / "data"), "--audit", "--workers", "1", *replay]) == 0
    assert "no problems" in capsys.readouterr().out
    assert main(["info", str(tmp_path / "data")]) == 0
    assert f"setting: {task.setting}" in capsys.readouterr().out


def test_an_export_names_its_setting_and_its_actions_are_replayed_in_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert collected(tmp_path / "data", *UNDER["all"]) == 0
    task = opened(tmp_path / "data")
    assert main(["export", str(tmp_path / "data"), "--format", "robomimic", "--failures"]) == 0
    card = (tmp_path / "data-robomimic" / "README.md").read_text()
    assert "| contact sheet" not in capsys.readouterr().out
    for row in (
        "| reflex | above 37.5 N",
        "| hidden physics | wide:joint_gain |",
        "| sensing | real |",
        "sensing='real')`",
    ):
        assert row in card, row
    arguments = json.loads(json.dumps(env_arguments_of(task, ActionLayout())))
    env = gym.make(env_of(task), **arguments)
    assert env.unwrapped.task.setting == task.setting  # type: ignore[attr-defined]
    env.close()


def test_a_folder_of_another_setting_is_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can")
    wide = get_task("can").under(physics="wide")
    dataset.note_source("oracle", Provenance("", task_digest(wide), setting=wide.setting))
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for flags in ([], ["--physics", "fixed"], ["--physics", "wide", "--sensing", "real"]):
        assert collected(tmp_path, *flags) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.count("\n") == 1
        assert "holds attempts under another setting (reflex contact, physics wide, sensing ideal)" in printed.err
        assert printed.err.endswith("or that setting: --reflex contact --physics wide --sensing ideal.\n")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    task = get_task("can")
    with pytest.raises(ValueError, match="under another setting"):
        dataset.note_source("planner_only", Provenance("", task_digest(task), setting=task.setting))


def test_a_setting_that_the_task_has_changed_since_is_still_used(tmp_path: Path) -> None:
    """So that `verify` names the changed definition, and no hidden field that is out of range."""
    dataset = DemonstrationDataset(tmp_path, task="can")
    dataset.note_source("oracle", Provenance("", "0" * 16, setting=Setting(physics="wide")))
    assert opened(tmp_path).setting.physics == "wide"


@pytest.mark.parametrize("noted", [3, {"physics": "wide"}, {"reflex": "x", "physics": "wide", "sensing": "ideal"}])
def test_a_malformed_setting_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str], noted: object) -> None:
    DemonstrationDataset(tmp_path, task="can")
    source = {"policy": "", "task_definition": "0" * 16, "setting": noted}
    (tmp_path / "generators.json").write_text(json.dumps({"oracle": source}))
    assert main(["verify", str(tmp_path)]) == 1
    assert re.search(r"generators\.json: it does not say what made the episodes", capsys.readouterr().out)
    assert collected(tmp_path) == 2


def test_a_setting_that_the_task_cannot_have_is_left_out(tmp_path: Path) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can")
    dataset.note_source("oracle", Provenance("", "0" * 16, setting=Setting(physics="wide:mass")))
    assert opened(tmp_path) is get_task("can")
