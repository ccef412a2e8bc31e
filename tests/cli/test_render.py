from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.observations import ObservationFolder
from dynaforge.generators import Goal, PlannerOnly, collect
from dynaforge.tasks import get_task


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    dataset = DemonstrationDataset(folder, task="can", keep_failures=True)
    collect(dataset, get_task("can"), PlannerOnly(), Goal(None, 2), workers=1)
    return folder


def test_render_fills_in_what_is_missing(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["render", str(data), "--cameras", "front", "--size", "16", "16", "--workers", "1"]
    assert main(command) == 0
    folder, names = ObservationFolder(data / "observations"), DemonstrationDataset(data).ids()
    assert folder.missing(names) == []
    assert folder[names[0]]["front/rgb"].shape[1:] == (16, 16, 3)
    folder.file_of(names[1]).unlink()
    assert main(command) == 0
    assert "2 episodes, 1 rendered" in capsys.readouterr().out
    assert folder.missing(names) == []
    assert main(["verify", str(data)]) == 0, "observations are no foreign files"
    assert main([*command, "--points", "9"]) == 2
    assert "other settings" in capsys.readouterr().err


def test_cameras_of_ones_own(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cameras = tmp_path / "cameras.json"
    cameras.write_text(
        json.dumps([{"name": "top", "eye": [0.5, 0.0, 1.2], "look_at": [0.5, 0.0, 0.0], "up": [1, 0, 0]}])
    )
    command = ["render", str(data), "--out", str(tmp_path / "seen"), "--size", "16", "16", "--workers", "1"]
    assert main([*command, "--cameras", "top"]) == 2
    assert "there are front, side, wrist" in capsys.readouterr().err
    assert main([*command, "--cameras", "top", "--camera-file", str(cameras)]) == 0
    stored = json.loads((tmp_path / "seen" / "settings.json").read_text())["cameras"][0]
    assert stored["name"] == "top"
    assert stored["intrinsics"][2] == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "{}",
        "[]",
        "[3]",
        '{"name": "top"}',
        '[{"name": "top"}]',
        "[" * 10_000,
        "\xff",
        '[{"name": "top", "eye": ["x", 0, 1], "look_at": [0, 0, 0]}]',
        '[{"name": "top", "eye": [NaN, 0, 1], "look_at": [0, 0, 0]}]',
        '[{"name": "top", "eye": [0, 0, 1], "look_at": [0, 0, 1]}]',
        '[{"name": "top", "eye": [0, 0, 1], "look_at": [0, 0, 0]}]',
        '[{"name": "top", "eye": [1, 0, 1], "look_at": [0, 0, 0], "size": [100000, 100000]}]',
        '[{"name": "../top", "eye": [1, 0, 1], "look_at": [0, 0, 0]}]',
        '[{"name": "other", "eye": [1, 0, 1], "look_at": [0, 0, 0]}]',
        json.dumps(2 * [{"name": "a", "eye": [1, 0, 1], "look_at": [0, 0, 0]}]),
    ],
)
def test_cameras_that_are_none_are_refused_and_leave_no_folder(
    data: Path, tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = tmp_path / "cameras.json"
    cameras.write_text(text, encoding="latin-1")
    command = ["render", str(data), "--out", str(tmp_path / "seen"), "--cameras", "front", "--workers", "1"]
    assert main([*command, "--camera-file", str(cameras)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"--camera-file {cameras}: " in said
    assert not (tmp_path / "seen").exists()


def test_what_cannot_be_written_ends_it_at_once(data: Path, tmp_path: Path) -> None:
    """Stands for a full disk: no file may be longer than 40 kB."""
    command = ["render", str(data), "--out", str(tmp_path / "seen"), "--workers", "1"]
    done = subprocess.run(
        [sys.executable, "-m", "dynaforge", *command],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000)),
    )
    assert done.returncode == 2
    assert f"File too large: '{tmp_path / 'seen'}" in done.stderr
    assert [path.name for path in (tmp_path / "seen").iterdir()] == ["settings.json"]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_at_random_instants_it_ends_with_the_same_files(data: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)

    def start(out: Path) -> subprocess.Popen[bytes]:
        command = ["render", str(data), "--out", str(out), "--cameras", "front", "--points", "64"]
        return subprocess.Popen(
            [sys.executable, "-m", "dynaforge", *command],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    killed, whole = tmp_path / "killed", tmp_path / "whole"
    for _ in range(20):
        process = start(killed)
        time.sleep(rng.uniform(2.0, 10.0))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if (killed / "settings.json").is_file():
            folder = ObservationFolder(killed)
            for path in killed.glob("[!.]*.h5"):
                assert len(folder[path.stem]["points"]) > 0, "whole, or not there"
    assert [start(killed).wait(), start(whole).wait()] == [0, 0]
    first, second = ObservationFolder(killed), ObservationFolder(whole)
    for name in DemonstrationDataset(data).ids():
        assert first[name].keys() == second[name].keys()
        for key, column in first[name].items():
            np.testing.assert_array_equal(column, second[name][key], err_msg=key)
