"""The page of `dynaforge view`: everything in it, escaped; looked at in a real browser where there is one."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaforge.cli.main import main
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.generators import Goal, PlannerOnly, collect
from dynaforge.reports.scene3d import SceneRecorder
from dynaforge.reports.viewer import write_viewer
from dynaforge.sim import Condition
from dynaforge.tasks import get_task

BROWSER = shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("chromium-browser")
QUIET = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--virtual-time-budget=3000")  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    pytest.importorskip("imageio_ffmpeg")
    folder = tmp_path_factory.mktemp("data")
    dataset = DemonstrationDataset(folder, task="can", keep_failures=True)
    collect(dataset, get_task("can"), PlannerOnly(), Goal(None, 3), workers=1)
    assert main(["view", str(folder), "--limit", "2"]) == 0
    return folder


def embedded(page: Path) -> list[dict[str, object]]:
    line = next(line for line in page.read_text().splitlines() if line.startswith("const EPISODES = "))
    return list(json.loads(line.removeprefix("const EPISODES = ").removesuffix(";").replace("<\\/", "</")))


def test_every_attempt_is_listed_and_the_chosen_are_shown(data: Path) -> None:
    rows = embedded(data / "view.html")
    dataset = DemonstrationDataset(data)
    assert {row["id"] for row in rows} == {attempt.id for attempt in dataset.attempts()}
    shown = [row for row in rows if "time" in row]
    assert len(shown) == 2
    for row in shown:
        episode = dataset[str(row["id"])]
        assert len(row["time"]) == len(episode)
        assert row["clip"].startswith("AAAA"), "an MP4 begins with the size of its first box"
        assert [phase["name"] for phase in row["phases"]][:2] == ["pregrasp", "track"]
        assert row["planned"] == episode.meta["planned_contact_time"]
        assert {plot["title"] for plot in row["plots"]} >= {"joints, rad", "can, m", "gripper, m"}
        assert all(len(line) == len(episode) for plot in row["plots"] for line in plot["lines"])
    text = (data / "view.html").read_text()
    assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in text


def test_a_reason_cannot_end_the_script(tmp_path: Path) -> None:
    condition = Condition("can", 1, 0.5, {"speed": 0.5})
    evil = Attempt(condition, "x", success=False, checkpoint=0, failure="</script><b>", phase="", duration=0.0)
    write_viewer(tmp_path / "v.html", get_task("can"), [evil], [], title="<i>")
    text = (tmp_path / "v.html").read_text()
    assert "</script><b>" not in text
    assert "<i>" not in text
    assert embedded(tmp_path / "v.html")[0]["failure"] == "</script><b>"


def test_scenes_in_three_dimensions_are_linked(data: Path, tmp_path: Path) -> None:
    pytest.importorskip("viser")
    page = tmp_path / "page.html"
    assert main(["view", str(data), "--limit", "1", "--no-clips", "--viser", "--out", str(page)]) == 0
    (row,) = [row for row in embedded(page) if "time" in row]
    assert row["scenes"] == {"scene in 3-D": f"page-scenes/{row['id']}.html"}
    text = (tmp_path / f"page-scenes/{row['id']}.html").read_text()
    assert "__VISER_EMBED_DATA__" in text


def test_every_link_is_drawn_where_the_episode_had_it(data: Path) -> None:
    pytest.importorskip("trimesh")
    dataset = DemonstrationDataset(data)
    episode = dataset[dataset.ids()[0]]
    recorder = SceneRecorder(get_task("can"))
    scene = recorder.record(episode)
    recorder.close()
    assert {name for name, _ in scene.meshes} == {"robot", "table", "can"}
    for step in (0, len(episode) - 1):
        np.testing.assert_allclose(scene.poses["can", -1][step].position, episode.steps["object/can/position"][step])
    low, high = scene.meshes["can", -1].bounds
    np.testing.assert_allclose(high - low, (0.066, 0.066, 0.12), atol=2e-3)
    left, right = (scene.poses["robot", link] for link in (9, 10))
    apart = np.linalg.norm([a.position - b.position for a, b in zip(left, right, strict=True)], axis=1)
    np.testing.assert_allclose(apart, episode.steps["width"], atol=2e-3)


def test_a_missing_extra_is_named_before_the_work(data: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["view", str(data), "--rerun"]) != 0
    assert "pip install 'dynaforge[rerun]'" in capsys.readouterr().err


def test_a_recording_for_rerun(data: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    page = tmp_path / "page.html"
    assert main(["view", str(data), "--limit", "1", "--no-clips", "--rerun", "--out", str(page)]) == 0
    (recording,) = (tmp_path / "page-scenes").glob("*.rrd")
    assert recording.read_bytes()[:4] == b"RRF2"


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
def test_a_browser_builds_list_plots_and_clip(data: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [str(BROWSER), *QUIET, f"--user-data-dir={tmp_path}", "--dump-dom", (data / "view.html").as_uri()],
        capture_output=True, text=True, timeout=100, check=True,
    )  # fmt: skip
    dom = done.stdout
    assert "3 of 3 attempts" in dom
    assert dom.count("<polyline") >= 20
    assert "<video" in dom
    assert "first contact" in dom
