from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.exporters import FORMATS
from dynaforge.demos.observations import ObservationFolder, ObservationSettings, standard_cameras
from dynaforge.generators import Goal, PlannerOnly, collect
from dynaforge.tasks import get_task

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "peach"
    dataset = DemonstrationDataset(folder, task="peach", keep_failures=True)
    collect(dataset, get_task("peach"), PlannerOnly(), Goal(None, 2), workers=1)
    return folder


@pytest.mark.parametrize("name", ["lerobot", "robomimic", "minari"])
def test_a_folder_and_its_card(data: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(data), "--format", name, "--failures", "--actions", "joint"]) == 0
    out = data.with_name(f"peach-{name}")
    assert "2 demonstrations" in capsys.readouterr().out
    card = (out / "README.md").read_text()
    for words in ("Peach: 2 demonstrations", "of 2 attempts", "joint_7, width", "license: mit", f"format | {name}"):
        assert words in card, words
    assert "| reflex | contact: above 100 N" in card
    assert "| peak force | median " in card
    assert (out / "contact.png").read_bytes().startswith(b"\x89PNG")
    assert main(["export", str(data), "--format", name]) == 2
    assert "exists already" in capsys.readouterr().err


def test_half_rendered_data_is_named_before_the_work(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As an interrupted `dynaforge render` leaves it."""
    seen = data.with_name("seen")
    ObservationFolder(seen, ObservationSettings((standard_cameras(get_task("peach"))["front"],)))
    command = ["export", str(data), "--format", "robomimic", "--failures", "--out", str(data.with_name("half"))]
    assert main([*command, "--observations", str(seen)]) == 2
    assert "lacks 2 of 2 episodes" in capsys.readouterr().err
    assert not data.with_name("half").exists()


def test_what_was_rendered_can_be_left_out_and_what_a_kill_left_is_cleared_away(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "peach"
    shutil.copytree(data, source)
    ObservationFolder(source / "observations", ObservationSettings((standard_cameras(get_task("peach"))["front"],)))
    out = tmp_path / "new" / "deeper"
    command = ["export", str(source), "--failures", "--no-observations", "--out", str(out)]
    assert main([*command, "--format", "dp3-zarr"]) == 2
    assert "needs point clouds" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    killed = out.with_name(".deeper.tmp") / "half.hdf5"
    killed.parent.mkdir(parents=True)
    killed.touch()
    assert main([*command, "--format", "robomimic", "--rotation", "rotation_6d"]) == 0
    assert [path.name for path in out.parent.iterdir()] == ["deeper"]
    card = (out / "README.md").read_text()
    assert "| actions | x, y, z, r1x, r1y, r1z, r2x, r2y, r2z, width, elbow |" in card
    assert "gymnasium.make('DynaForge/PeachTask-v0', action_mode='ee', rotation='rotation_6d', elbow=True, " in card
    assert "| observations | state of the robot |" in card
    assert "peach_position" in card
    assert "| instruction | pick up the rolling peach and put it into the moving bowl |" in card


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--observations", "OBSERVATIONS", "--no-observations"], "--no-observations leaves out"),
        (["--actions", "joint", "--rotation", "rotation_6d"], "--rotation rotation_6d belongs to --actions ee"),
        (["--format", "minari", "--observations", "OBSERVATIONS"], "holds neither pictures nor points"),
        (["--license", ""], "SPDX"),
        (["--license", "MIT\nlicense: other"], "SPDX"),
    ],
)
def test_options_that_contradict_each_other_are_refused_before_the_work(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    seen = tmp_path / "seen"
    ObservationFolder(seen, ObservationSettings((standard_cameras(get_task("peach"))["front"],)))
    given = [str(seen) if option == "OBSERVATIONS" else option for option in options]
    try:
        status = main(["export", str(data), "--format", "robomimic", "--out", str(tmp_path / "out"), *given])
    except SystemExit as leaving:  # argparse's way
        status = int(leaving.code or 0)
    assert status == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_exported_leaves_nothing(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(data), "--format", "dp3-zarr", "--failures"]) == 2
    assert "dynaforge render" in capsys.readouterr().err
    assert not list(data.parent.glob("*zarr*"))
    assert not list(data.parent.glob(".*"))
    assert {"lerobot", "robomimic", "minari", "dp3-zarr"} == set(FORMATS)


def test_what_cannot_be_simulated_again_is_exported_without_a_contact_sheet(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As with other versions of the physics; the card keeps the generators apart."""
    original = DemonstrationDataset(data)
    dataset = DemonstrationDataset(tmp_path / "peach", task="peach", keep_failures=True)
    for k, episode in enumerate(original):
        steps = dict(episode.steps) | {"q": episode.steps["q"] + 1e-9}
        dataset.add(replace(episode, steps=steps, generator=("planner_only", "residual")[k]))
    assert main(["export", str(dataset.path), "--format", "robomimic", "--failures"]) == 0
    assert "no contact sheet: Episode" in capsys.readouterr().out
    out = tmp_path / "peach-robomimic"
    card = (out / "README.md").read_text()
    assert not (out / "contact.png").exists()
    assert "contact.png" not in card
    assert "planner_only: " in card
    assert "residual: " in card
    assert main(["view", str(dataset.path)]) == 2
    assert "`--no-clips`" in capsys.readouterr().err
    assert main(["view", str(dataset.path), "--no-clips"]) == 0
