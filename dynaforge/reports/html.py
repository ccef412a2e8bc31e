"""One self-contained HTML page about a run: numbers, figures, clips, ledger, and how to make it again."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynaforge.demos import Attempt
from dynaforge.evaluation import DgrReport, PairedDifference
from dynaforge.evaluation.dgr import ranked_reasons
from dynaforge.evaluation.dgr_tables import describe_gain
from dynaforge.files.atomic import atomic_write
from dynaforge.geometry import one_line
from dynaforge.reports.extras import load_extra
from dynaforge.reports.template import PAGE, STYLE
from dynaforge.tasks import Outcome

MOST_ATTEMPTS = 500


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """A figure of a report.

    Attributes:
        title: Headline.
        caption: Text below it.
        image: PNG or SVG bytes, as the functions of `plots` return them.
    """

    title: str
    caption: str
    image: bytes

    __repr__ = one_line


@dataclass(frozen=True, slots=True)
class Clip:
    """A filmed attempt.

    Attributes:
        mp4: The film, MP4 bytes.
        condition_id: Id of its condition.
        outcome: How it ended.
        caption: Text below it.
    """

    mp4: bytes
    condition_id: str
    outcome: Outcome
    caption: str = ""

    __repr__ = one_line


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportData:
    """What a report shows.

    Attributes:
        title, task: Headline and task name.
        command: The command that makes this report again.
        date: The date to print; it is passed in, so that equal runs give equal pages.
        seeds, versions: What to print by name, e.g. {"training seed": 0}, {"numpy": "2.4.0"}.
        reports: Rates to compare, planner only first.
        paired: The last report against the first, on the same conditions.
        figures, clips: Figures and clips, in the order in which they are shown.
        attempts: The ledger; the first 500 are listed.
        notes: Sentences below the table of rates.
    """

    title: str
    task: str
    command: str
    date: str
    seeds: Mapping[str, Any]
    versions: Mapping[str, str]
    reports: Sequence[DgrReport]
    paired: PairedDifference | None = None
    figures: Sequence[ReportFigure] = ()
    clips: Sequence[Clip] = ()
    attempts: Sequence[Attempt] = ()
    notes: Sequence[str] = ()


def render_report(data: ReportData) -> str:
    """Return the page as HTML; everything from the data is escaped, and the page loads nothing from elsewhere.

    Raises:
        ImportError: Jinja2, of the `[report]` extra, is missing.
        ValueError: A figure is neither PNG nor SVG.
    """
    shown = list(data.attempts)[:MOST_ATTEMPTS]
    hidden = len(data.attempts) - len(shown)
    return render(PAGE, data=data, reasons=ranked_reasons(data.reports), shown=shown, hidden=hidden)


def render(template: str, **values: Any) -> str:
    """Fill a template of `dynaforge.reports.template`; all values are escaped.

    Args:
        template: Text of the template.
        values: What it refers to by name.

    Raises:
        ImportError: Jinja2, of the `[report]` extra, is missing.
        ValueError: A figure is neither PNG nor SVG.
    """
    jinja2 = load_extra("jinja2")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters.update(
        percent=_percent, points=_points, gain=describe_gain, image_url=_image_url, video_url=_video_url
    )
    return str(environment.from_string(template).render(style=load_extra("markupsafe").Markup(STYLE), **values))


def script_data(value: Any) -> Any:
    """Return plain data as a JavaScript literal that is safe inside a script element, whatever its strings say.

    Raises:
        ImportError: MarkupSafe, of the `[report]` extra, is missing.
        ValueError: A number is infinite or NaN.
    """
    # "</script>" would end the element; "<!--" and "<script" would hide its end from the browser.
    return load_extra("markupsafe").Markup(json.dumps(value, allow_nan=False).replace("<", "\\u003c"))


def write_report(path: str | Path, data: ReportData) -> None:
    """Write the page, whole or not at all.

    Raises:
        ImportError, ValueError: As `render_report`.
        OSError: The folder is missing or not writable, or the disk is full.
    """
    atomic_write(path, render_report(data).encode())


def _percent(rate: float) -> str:
    return "–" if math.isnan(rate) else f"{100 * rate:.1f} %"


def _points(difference: float) -> str:
    return f"{100 * difference:+.1f}"


def _image_url(image: bytes) -> str:
    if image.startswith(b"\x89PNG"):
        return _data_url("image/png", image)
    if b"<svg" in image[:2000]:
        return _data_url("image/svg+xml", image)
    raise ValueError("A figure of a report must be PNG or SVG bytes.")


def _video_url(mp4: bytes) -> str:
    return _data_url("video/mp4", mp4)


def _data_url(mime: str, content: bytes) -> str:
    return f"data:{mime};base64,{base64.b64encode(content).decode()}"
