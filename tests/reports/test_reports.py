from __future__ import annotations

import io
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
Image = pytest.importorskip("PIL.Image")

from dynaforge.demos import Attempt  # noqa: E402
from dynaforge.evaluation import DgrReport, analyse_frontier, paired_difference  # noqa: E402
from dynaforge.reports import (  # noqa: E402
    Clip,
    ReportData,
    ReportFigure,
    contact_sheet,
    dgr_by_difficulty,
    encode_gif,
    encode_mp4,
    extras,
    failure_bars,
    learning_curve,
    render_report,
    stratum_heatmap,
    write_report,
)
from dynaforge.sim import Condition  # noqa: E402
from dynaforge.tasks import Outcome  # noqa: E402

WON = Outcome(success=True, checkpoint=4, phase="close")
LOST = Outcome(success=False, checkpoint=1, failure="<timeout>", phase="close")


def attempts(rate: float, n: int = 60) -> list[Attempt]:
    ok = np.random.default_rng(0).random(n) < rate
    return [
        Attempt(condition=Condition("can", i, i / n, {}), generator="planner", outcome=WON if s else LOST, duration=2.0)
        for i, s in enumerate(ok)
    ]


def report(rate: float, label: str) -> DgrReport:
    return DgrReport.from_attempts(attempts(rate), difficulty_range=(0.0, 1.0), label=label)


def film(n: int = 6, height: int = 49, width: int = 65) -> list[np.ndarray]:
    return [np.full((height, width, 3), 40 * i, dtype=np.uint8) for i in range(n)]


@pytest.fixture(scope="module")
def mp4() -> bytes:
    return encode_mp4(film(), fps=10)


def figures() -> dict[str, object]:
    outcomes = np.random.default_rng(0).random((30, 16, 8)) < np.linspace(1.0, 0.1, 16)[None, :, None]
    analysis = analyse_frontier(outcomes.sum(axis=2), 8)
    two = [report(0.4, "planner only"), report(0.8, "residual")]
    return {
        "curve": lambda fmt: learning_curve(
            {"frontier": analysis.overall, "vanilla": analysis.overall / 2}, planner_only=0.4, final=0.9, fmt=fmt
        ),
        "heatmap": lambda fmt: stratum_heatmap(analysis, fmt=fmt),
        "bins": lambda fmt: dgr_by_difficulty(two, unit="m/s", fmt=fmt),
        "failures": lambda fmt: failure_bars(two, fmt=fmt),
        "no failures": lambda fmt: failure_bars([report(1.1, "perfect")], fmt=fmt),
        "empty bins": lambda fmt: dgr_by_difficulty(
            [DgrReport.from_attempts(attempts(0.5), difficulty_range=(0.0, 9.0), label="x")], fmt=fmt
        ),
    }


@pytest.mark.parametrize("name", figures())
def test_figures_draw_without_warnings_at_800_pixels(name):
    draw = figures()[name]
    png = draw("png")
    assert png.startswith(b"\x89PNG")
    assert int.from_bytes(png[16:20], "big") == 800
    assert b"<svg" in draw("svg")[:2000]


def test_equal_data_give_equal_figures():
    assert figures()["heatmap"]("svg") == figures()["heatmap"]("svg")


def test_different_bins_are_not_drawn_together():
    other = DgrReport.from_attempts(attempts(0.5), difficulty_range=(0.0, 2.0))
    with pytest.raises(ValueError, match="different difficulty bins"):
        dgr_by_difficulty([report(0.5, "x"), other])


def test_mp4_is_h264_yuv420p_with_its_index_in_front(mp4, tmp_path):
    assert mp4.index(b"moov") < mp4.index(b"mdat")
    path = tmp_path / "film.mp4"
    path.write_bytes(mp4)
    program = imageio_ffmpeg.get_ffmpeg_exe()
    shown = subprocess.run([program, "-i", str(path)], capture_output=True, text=True, timeout=20, check=False).stderr
    assert re.search(r"Video: h264 .*yuv420p.* 66x50", shown)
    command = [program, "-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, capture_output=True, timeout=20, check=True).stdout
    frames = np.frombuffer(raw, np.uint8).reshape(-1, 50, 66, 3)
    assert len(frames) == 6
    np.testing.assert_allclose(frames.mean((1, 2, 3)), [40 * i for i in range(6)], atol=6)


def test_gif_and_contact_sheet_have_the_requested_size():
    gif = encode_gif(film(), fps=10, width=32)
    assert gif.startswith(b"GIF89a")
    assert int.from_bytes(gif[6:8], "little") == 32
    sheet = contact_sheet(film(5), ["a label far too long for its cell"] * 5, columns=3, cell_width=65)
    width, height = (int.from_bytes(sheet[at : at + 4], "big") for at in (16, 20))
    assert (width, height) == (8 + 3 * 73, 8 + 2 * (49 + 26 + 8))
    pixels = np.asarray(Image.open(io.BytesIO(sheet)))
    assert (pixels[:, -8:] == 255).all()  # no label leaves its cell
    with pytest.raises(ValueError, match="5 frames need as many labels"):
        contact_sheet(film(5), ["one"])


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], "at least one frame"),
        ([np.zeros((4, 4, 3), np.uint8), np.zeros((4, 6, 3), np.uint8)], "one size"),
        ([np.zeros((4, 4, 3))], "uint8"),
    ],
)
def test_frames_that_make_no_film_are_refused(frames, message):
    with pytest.raises(ValueError, match=message):
        encode_mp4(frames)


def data(mp4: bytes) -> ReportData:
    before, after = attempts(0.4), attempts(0.8)
    return ReportData(
        title="Can <end to end>",
        task="can",
        command="dynaforge forge --task can",
        date="1 March 2026",
        seeds={"training seed": 7},
        versions={"numpy": np.__version__},
        reports=[report(0.4, "planner only"), report(0.8, "with residual")],
        paired=paired_difference([a.success for a in before], [a.success for a in after]),
        figures=[ReportFigure("Learning curve", "Trailing mean.", figures()["curve"]("svg"))],
        clips=[Clip(mp4, "c0ffee", WON, "0.3 m/s"), Clip(mp4, "decade", LOST, "1.2 m/s")],
        attempts=before * 10,
    )


class Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.urls: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.urls += [value for key, value in attrs if key in ("src", "href")]
        if tag not in ("meta", "link", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_report_is_one_well_formed_page_that_loads_nothing(mp4, tmp_path):
    write_report(tmp_path / "report.html", data(mp4))
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    links = Links()
    links.feed((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert links.open == []
    assert all(url.startswith("data:") for url in links.urls)
    assert sum(url.startswith("data:video/mp4;base64,") for url in links.urls) == 2
    assert sum(url.startswith("data:image/svg+xml;base64,") for url in links.urls) == 1


def test_report_contains_what_it_must(mp4):
    given = data(mp4)
    page = render_report(given)
    low, high = given.reports[1].interval
    for expected in (
        "dynaforge forge --task can",
        "training seed",
        np.__version__,
        "1 March 2026",
        "with residual",
        f"{100 * low:.1f} % – {100 * high:.1f} %",
        f"{100 * given.paired.difference:+.1f}",
        "exact McNemar",
        "c0ffee",
        "1.2 m/s",
        given.attempts[0].condition.id,
        "600 attempts, the first 500 listed",
    ):
        assert expected in page, expected


def test_report_escapes_what_it_is_given(mp4):
    page = render_report(data(mp4))
    assert "<timeout>" not in page
    assert "&lt;timeout&gt;" in page
    assert "<title>Can &lt;end to end&gt;</title>" in page


def bare(reports: list[DgrReport]) -> ReportData:
    return ReportData(title="t", task="can", command="c", date="d", seeds={}, versions={}, reports=reports)


def test_report_without_clips_figures_and_comparison_is_still_a_page():
    page = render_report(bare([report(0.5, "planner only")]))
    assert "<h2>Clips</h2>" not in page
    assert "50" in page
    with pytest.raises(ValueError, match="PNG or SVG"):
        render_report(replace(bare([]), figures=[ReportFigure("f", "", b"text")]))


def test_missing_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"dynaforge\[report\]"):
        extras.load_extra("matplotlib")
    with pytest.raises(ImportError, match="matplotlib"):
        learning_curve({"x": [0.0, 1.0]})


def test_importing_reports_does_not_import_the_extra():
    code = "import sys, dynaforge.reports; assert not {'matplotlib', 'jinja2', 'imageio_ffmpeg'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
