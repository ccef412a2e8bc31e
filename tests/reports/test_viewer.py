"""The page of `dynaforge view`: everything in it, escaped; looked at in a real browser where there is one."""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import chromium
import numpy as np
import pytest
from chromium import Chromium

from dynaforge.cli.main import main
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.demos.observations import ObservationFolder, ObservationSettings, standard_cameras
from dynaforge.generators import Goal, PlannerOnly, collect
from dynaforge.reports import viewer_clips
from dynaforge.reports.scene3d import SceneRecorder
from dynaforge.reports.viewer import write_viewer
from dynaforge.reports.viewer_clips import ViewerEpisode
from dynaforge.reports.viewer_summary import summarise
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome, get_task

BROWSER = chromium.PROGRAM
CAN = get_task("can")
EVERY = 12  # control steps from picture to picture: a picture takes an eighth of a second
HOSTILE = (
    "</script><script>window.hacked=1</script><!--<script><img src=x onerror=window.hacked=2>\u2028'\"&{{ 7 * 7 }}"
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    pytest.importorskip("imageio_ffmpeg")
    folder = tmp_path_factory.mktemp("data")
    dataset = DemonstrationDataset(folder, task="can", keep_failures=True)
    collect(dataset, CAN, PlannerOnly(), Goal(None, 3), workers=1)
    cameras = [replace(standard_cameras(CAN)[name], size=(15, 9)) for name in ("side", "wrist")]
    observations = ObservationFolder(folder / "observations", ObservationSettings(tuple(cameras)))
    for episode in dataset:
        layout = observations.settings.layout
        observations.write(episode, {n: np.zeros((len(episode), *s), t) for n, (s, t) in layout.items()}, [])
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(viewer_clips, "FRAME_STEPS", EVERY)
        assert main(["view", str(folder), "--limit", "2", "--workers", "1"]) == 0
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
    evil = attempt(1, "</script><b>", phase="")
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
        np.testing.assert_allclose(scene.poses["can", "can"][step].position, episode.steps["object/can/position"][step])
    low, high = scene.meshes["can", "can"].bounds
    np.testing.assert_allclose(high - low, (0.066, 0.066, 0.12), atol=2e-3)
    left, right = (scene.poses["robot", f"panda_{side}finger"] for side in ("left", "right"))
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


def attempt(seed: int, failure: str = "lost track", *, phase: str = "track", **values: Any) -> Attempt:
    condition = Condition("can", seed, 0.5, {"speed": 0.5, **values.pop("more", {})})
    outcome = Outcome(success=not failure, checkpoint=1, failure=failure, phase=phase)
    return Attempt(**{"condition": condition, "generator": "x", "outcome": outcome, "duration": 1.0, **values})


def test_every_value_has_its_unit(data: Path) -> None:
    for row in embedded(data / "view.html"):
        units = {name: unit for name, _, unit in row["values"]}
        assert units == {name: CAN.conditions.units.get(name, "") for name in CAN.conditions.ranges}
        assert (units["speed"], units["mass"], units["side"]) == ("m/s", "kg", "")


def test_a_clip_lasts_as_long_as_its_episode(data: Path, tmp_path: Path) -> None:
    """At real speed, as the views of its cameras do."""
    program = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    row = next(row for row in embedded(data / "view.html") if "time" in row)
    assert [name for name, _ in row["views"]] == ["side", "wrist"]
    for film, picture in ((row["clip"], EVERY), (row["views"][0][1], 1)):
        path = tmp_path / "film.mp4"
        path.write_bytes(base64.b64decode(film))
        command = [program, "-i", str(path)]
        printed = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False).stderr
        found = re.search(r"Duration: 00:00:([\d.]+)", printed)
        assert found
        assert abs(float(found[1]) - len(row["time"]) / 30) <= picture / 30


def test_what_is_not_shown_is_explained(tmp_path: Path) -> None:
    attempts = [
        attempt(0, "lost track"),
        attempt(1, "exception: KeyError", phase="", duration=0.0),
        attempt(2, "", recorded=True),
        attempt(3, "", recorded=True),
    ]
    write_viewer(tmp_path / "v.html", CAN, attempts, [], title="t", recorded=[attempts[2].id])
    notes = {row["id"]: row["note"] for row in embedded(tmp_path / "v.html")}
    for one, words in zip(attempts, ("--keep-failures", "before there was", "--limit 1", "gone"), strict=True):
        assert words in notes[one.id]


def test_the_summary_counts_every_attempt() -> None:
    fast = attempt(9, "")
    object.__setattr__(fast, "condition", replace(fast.condition, difficulty=1.5))
    summary = summarise(CAN, [attempt(1), attempt(2), attempt(3, "dropped", duration=4.0), fast])
    assert [count[1:3] for count in summary["bins"]] == [[0, 0]] * 2 + [[3, 0]] + [[0, 0]] * 4 + [[1, 1]]
    assert summary["failures"] == [("lost track", 2), ("dropped", 1)]
    assert summary["generators"][0][:3] == ["x", 4, 1]
    assert summary["lengths"]["longest"] == 4.0
    assert (sum(summary["lengths"]["successes"]), sum(summary["lengths"]["failures"])) == (1, 3)


def test_a_recording_that_cannot_be_read_leaves_a_page(data: Path, tmp_path: Path, capsys: Any) -> None:
    dataset = DemonstrationDataset(tmp_path / "can", task="can", keep_failures=True)
    for episode in DemonstrationDataset(data):
        dataset.add(episode)
    name = dataset.ids()[0]
    dataset.file_of(name).write_bytes(b"broken")
    assert main(["view", str(dataset.path), "--no-clips", "--workers", "1"]) == 1
    assert f"{name}: The recording cannot be read" in capsys.readouterr().out
    rows = {row["id"]: row for row in embedded(dataset.path / "view.html")}
    assert "cannot be read" in rows[name]["note"]
    assert sum("time" in row for row in rows.values()) == 2


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    if BROWSER is None:
        pytest.skip("no Chromium here")
    browser = Chromium(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


def test_a_browser_builds_list_plots_and_clip(data: Path, browser: Chromium) -> None:
    browser.open((data / "view.html").as_uri())
    assert "3 of 3 attempts" in browser.ask("document.body.innerText")
    assert browser.ask("document.querySelectorAll('polyline').length") >= 20
    assert browser.ask("document.querySelectorAll('video').length") == 1
    assert "first contact" in browser.ask("document.body.innerText")
    browser.until("document.querySelector('video').videoWidth === 480")
    browser.ask("document.querySelectorAll('#clip [role=tab]')[2].click()")
    browser.until("document.querySelector('video').videoWidth === 16")  # of the wrist's 15, padded
    assert browser.errors == []


def test_every_episode_has_an_address(data: Path, browser: Chromium) -> None:
    page, rows = (data / "view.html").as_uri(), embedded(data / "view.html")
    selected = "document.querySelector('#list [aria-current=true] small').textContent"
    browser.open(page)
    texts = browser.ask("[...document.querySelectorAll('#list small')].map(e => e.textContent)")
    assert browser.ask(selected) == texts[0]
    for _ in range(2):
        browser.press("n")
    browser.until(f"location.hash === '#episode={rows[2]['id']}' && {selected} === {json.dumps(texts[2])}")
    browser.press("n")  # there is none after the last
    browser.press("p")
    browser.until(f"{selected} === {json.dumps(texts[1])}")
    browser.ask("history.back()")
    browser.until(f"{selected} === {json.dumps(texts[2])}")
    browser.ask("history.forward()")
    browser.until(f"{selected} === {json.dumps(texts[1])}")
    browser.call("Page.reload")
    browser.until(f"document.readyState === 'complete' && {selected} === {json.dumps(texts[1])}")
    browser.press("s")
    browser.until(
        "!document.getElementById('panel-summary').hidden && document.getElementById('panel-episodes').hidden"
    )
    browser.ask("history.back()")
    browser.until("document.getElementById('panel-summary').hidden")
    browser.open(page + "#episode=%3Cb%3E")
    assert "This page contains no episode <b>." in browser.ask("document.body.innerText")
    assert browser.errors == []


def test_focus_is_kept(data: Path, browser: Chromium) -> None:
    browser.open((data / "view.html").as_uri())
    active = "document.activeElement"
    browser.ask("document.querySelector('#list button').focus()")
    browser.press("ArrowDown")
    browser.press("Enter", text="\r")
    browser.until("location.hash !== ''")
    assert browser.ask(f"{active}.getAttribute('aria-current')") == "true", "the row that was chosen"
    browser.press("p")
    browser.until(f"{active} === document.querySelector('#list button')")
    browser.ask("document.querySelectorAll('#clip [role=tab]')[1].focus()")
    browser.press("n")
    browser.until("document.querySelectorAll('#list button')[1].getAttribute('aria-current') === 'true'")
    assert browser.ask(f"{active}.textContent") == "side", "the same camera of the next episode"
    browser.press("/")
    browser.press("z")
    browser.press("n")
    assert browser.ask(f"{active}.value") == "zn", "keys are text where text is asked for"
    assert "No attempt fits these filters." in browser.ask("document.body.innerText")
    browser.ask("document.querySelector('.empty button').click()")
    assert browser.ask(f"{active}.id") == "words"
    assert browser.ask("document.querySelectorAll('#list button').length") == 3
    assert browser.ask("document.querySelectorAll('#list button[tabindex=\"0\"]').length") == 1, "one stop for Tab"
    assert browser.errors == []


def test_a_phone_scrolls_to_what_was_chosen(data: Path, browser: Chromium) -> None:
    browser.open((data / "view.html").as_uri(), width=390, height=600)
    assert browser.ask("document.documentElement.scrollWidth") <= 390
    top = "document.getElementById('detail').getBoundingClientRect().top"
    assert browser.ask(top) > 300
    browser.ask("document.querySelectorAll('#list button')[1].click()")
    browser.until(f"Math.abs({top}) < 20")
    assert browser.ask("document.activeElement.id") == "heading"
    browser.ask("document.getElementById('toList').click()")
    browser.until(f"{top} > 300")
    browser.press("s")
    browser.until("document.getElementById('panel-episodes').hidden")
    assert browser.ask("document.documentElement.scrollWidth") <= 390
    assert browser.errors == []


def test_nothing_in_the_data_runs(data: Path, tmp_path: Path, browser: Chromium) -> None:
    dataset = DemonstrationDataset(data)
    episode = dataset[dataset.ids()[0]]
    meta = {**episode.meta, "phases": [HOSTILE, {"a": HOSTILE}], "contact_time": HOSTILE}
    evil = replace(episode, condition=replace(episode.condition, values={HOSTILE: 0.5, "__proto__": 0.5}), meta=meta)
    shown = ViewerEpisode(id=evil.id, episode=evil, views={HOSTILE: b"", "__proto__": b"", "b": b""}, note=HOSTILE)
    attempts = [Attempt.of(evil), attempt(1, HOSTILE, phase=HOSTILE), attempt(2, "constructor")]
    write_viewer(tmp_path / "v.html", CAN, attempts, [shown], title=HOSTILE)
    page = (tmp_path / "v.html").as_uri()
    for address in ("", f"#episode={attempts[1].id}", "#summary", "#episode=%"):
        browser.open(page + address)
        assert browser.ask("String(window.hacked)") == "undefined"
        assert browser.ask("document.querySelectorAll('img, iframe, script').length") == 1
        assert browser.ask("document.querySelector('h1').textContent") == HOSTILE
    assert (
        browser.ask("[...document.querySelectorAll('#list .bad')].map(e => e.textContent)").count("✗ " + HOSTILE) == 1
    )
    assert browser.errors == []


def test_empty_lists_say_so(tmp_path: Path, browser: Chromium) -> None:
    write_viewer(tmp_path / "none.html", CAN, [], [], title="none")
    browser.open((tmp_path / "none.html").as_uri())
    assert "The folder contains no attempts yet." in browser.ask("document.body.innerText")
    browser.press("n")
    browser.press("s")
    browser.until("document.body.innerText.includes('No attempts yet.')")
    write_viewer(tmp_path / "succeeded.html", CAN, [attempt(1, "")], [], title="succeeded")
    browser.open((tmp_path / "succeeded.html").as_uri() + "#summary")
    assert "No failures." in browser.ask("document.body.innerText")
    assert browser.errors == []
