"""Figures of a report as SVG or PNG bytes, readable at 800 pixels and for the colour-blind.

No pyplot and no global state: each figure is made, drawn and dropped.
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from dynaforge.evaluation import DgrReport, FrontierAnalysis
from dynaforge.evaluation.dgr import Count, ranked_reasons
from dynaforge.evaluation.frontier import WINDOW, trailing_mean
from dynaforge.evaluation.psychometric import PsychometricCurve
from dynaforge.reports.extras import load_extra

Format = Literal["svg", "png"]

# The palette of Okabe and Ito, whose colours can be told apart with any colour vision.
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#6B7280"
_CURVES = (BLUE, ORANGE, GREEN, "#CC79A7", "#56B4E9")
_STYLE = {
    "font.size": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.titlesize": 12,
    "axes.titlelocation": "left",
    "grid.color": "#E5E7EB",
    "svg.fonttype": "path",
    "svg.hashsalt": "dynaforge",
    "legend.frameon": False,
}


def learning_curve(
    success: Mapping[str, ArrayLike],
    *,
    planner_only: float | None = None,
    final: float | Mapping[str, float] | None = None,
    steps: Mapping[str, ArrayLike] | None = None,
    window: int = WINDOW,
    fmt: Format = "svg",
) -> bytes:
    """Draw success during training: trailing mean as a line, each update as a faint trace.

    Args:
        success: Success fraction of each update, shape (U,), by the name of the run.
        planner_only: Rate of planner only, drawn as a horizontal line.
        final: Rate of the final policy, drawn as a horizontal line: one for all runs, or one for each by name.
        steps: Environment steps at each update, shape (U,), by the name of the run; None draws over updates.
        window: Updates in the trailing mean.
        fmt: Format of the image.
    """
    with _drawing((8.0, 4.0)) as (figure, axes):
        for colour, (name, values) in zip(_cycle(len(success)), success.items(), strict=True):
            where = np.arange(1, np.size(values) + 1) if steps is None else np.asarray(steps[name])
            axes.plot(where, np.asarray(values, dtype=float), color=colour, alpha=0.25, linewidth=1)
            axes.plot(where, trailing_mean(values, window), color=colour, linewidth=2.2, label=name)
            if isinstance(final, Mapping) and name in final:
                axes.axhline(final[name], color=colour, linestyle="-.", linewidth=1.2)
        overall = None if isinstance(final, Mapping) else final
        levels = (("planner only", planner_only, "--", GREY), ("final policy", overall, "-.", RED))
        for label, level, dash, colour in levels:
            if level is not None:
                axes.axhline(level, color=colour, linestyle=dash, linewidth=1.5, label=f"{label} {level:.0%}")
        _percent(axes)
        axes.set_xlabel("update" if steps is None else "environment steps")
        axes.set_ylabel("success in training")
        axes.grid(axis="y")
        if axes.get_legend_handles_labels()[1]:
            figure.legend(loc="outside lower center", ncols=3)
        return _bytes(figure, fmt)


def stratum_heatmap(analysis: FrontierAnalysis, *, fmt: Format = "svg") -> bytes:
    """Draw each stratum's trailing success over the updates, the easiest at the bottom, with the frontier in red."""
    with _drawing((8.0, 4.2)) as (figure, axes):
        updates, strata = analysis.trailing.shape
        ranked = analysis.trailing[:, analysis.order].T  # (N, U)
        image = axes.imshow(
            ranked,
            aspect="auto",
            origin="lower",
            extent=(0.5, updates + 0.5, 0.0, strata),
            vmin=0.0,
            vmax=1.0,
            cmap="cividis",
            interpolation="nearest",
        )
        where = np.arange(1, updates + 1)
        axes.plot(where, analysis.frontier, color="white", linewidth=4.2)
        axes.plot(where, analysis.frontier, color="#E00000", linewidth=2.2, label="competence frontier")
        axes.set_ylim(0.0, strata + 0.02 * strata)
        labelled = np.arange(strata) if strata <= 20 else np.linspace(0, strata - 1, 12).astype(int)
        axes.set_yticks(labelled + 0.5, [str(analysis.order[rank] + 1) for rank in labelled])
        axes.set_xlabel("update")
        axes.set_ylabel("stratum, ranked by full-run success")
        bar = figure.colorbar(image, ax=axes, pad=0.02)
        _percent(bar.ax)
        bar.set_label(f"success, last {WINDOW} updates")
        figure.legend(loc="outside lower center")
        return _bytes(figure, fmt)


def probe_curve(success: Mapping[str, ArrayLike], steps: Mapping[str, ArrayLike], *, fmt: Format = "svg") -> bytes:
    """Draw success without exploration, as probed during training.

    Args:
        success: Success fraction of each probe, shape (P,), by the name of the run.
        steps: Environment steps before each probe, shape (P,), by the name of the run.
        fmt: Format of the image.
    """
    with _drawing((8.0, 3.4)) as (figure, axes):
        for colour, (name, values) in zip(_cycle(len(success)), success.items(), strict=True):
            axes.plot(
                np.asarray(steps[name]), np.asarray(values), color=colour, linewidth=1.8, marker="o", ms=4, label=name
            )
        _percent(axes)
        axes.set_xlabel("environment steps")
        axes.set_ylabel("success without exploration")
        axes.grid(axis="y")
        figure.legend(loc="outside lower center", ncols=3)
        return _bytes(figure, fmt)


def dgr_by_difficulty(reports: Sequence[DgrReport], *, unit: str = "", fmt: Format = "svg") -> bytes:
    """Draw success by difficulty bin with Wilson 95 % error bars, one series per report.

    Args:
        reports: Reports over the same bins, e.g. of planner only and of the residual.
        unit: Unit of the difficulty, e.g. "m/s".
        fmt: Format of the image.

    Raises:
        ValueError: The bins differ.
    """
    edges = np.asarray(reports[0].edges)
    if any(len(report.edges) != len(edges) or not np.allclose(report.edges, edges) for report in reports):
        raise ValueError("The reports are over different difficulty bins.")
    with _drawing((8.0, 4.0)) as (figure, axes):
        place = np.arange(len(edges) - 1)
        width = 0.8 / len(reports)
        colours = (GREY, *_CURVES) if len(reports) > 1 else _CURVES
        for index, report in enumerate(reports):
            offset = (index - (len(reports) - 1) / 2) * width
            heights, errors = _bars(report.bins)
            axes.bar(
                place + offset,
                heights,
                width * 0.92,
                yerr=errors,
                color=colours[index % len(colours)],
                label=f"{report.label} {report.total.rate:.1%}",
                error_kw={"ecolor": "#111827", "elinewidth": 1.2, "capsize": 2.5},
            )
        labels = [f"{low:.2g}-{high:.2g}" for low, high in itertools.pairwise(edges)]
        axes.set_xticks(place, labels)
        _percent(axes)
        axes.set_xlabel(f"difficulty ({unit})" if unit else "difficulty")
        axes.set_ylabel("success")
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        figure.legend(loc="outside lower center", ncols=3)
        return _bytes(figure, fmt)


def psychometric_curves(
    panels: Mapping[str, Mapping[str, tuple[PsychometricCurve, DgrReport]]], *, fmt: Format = "svg"
) -> bytes:
    """Draw success against speed, a panel for each task: the fitted curves, and the rates of difficulty bins as dots.

    Args:
        panels: Task to the label of each generator to its curve and its report.
        fmt: Format of the image.
    """
    labels = list(dict.fromkeys(label for curves in panels.values() for label in curves))
    style = {
        label: {"color": colour, "linewidth": 1.8, "linestyle": "-" if k < len(_CURVES) else "--"}
        for k, (label, colour) in enumerate(zip(labels, _cycle(len(labels)), strict=True))
    }
    columns = min(3, max(len(panels), 1))
    rows = -(-len(panels) // columns)
    with _drawing((11.0, 0.8 + 2.4 * rows), (rows, columns)) as (figure, grid):
        for axes in grid.flat[len(panels) :]:
            axes.remove()
        for axes, (task, curves) in zip(grid.flat, panels.items(), strict=False):
            axes.set_title(task)
            for label, (curve, report) in curves.items():
                x = np.linspace(*curve.span, 200)
                axes.plot(x, curve.at(x), **style[label])
                if np.allclose((report.edges[0], report.edges[-1]), curve.span):
                    middles = [(low + high) / 2 for low, high in itertools.pairwise(report.edges)]
                    dots = style[label] | {"linestyle": "", "marker": "."}
                    axes.plot(middles, [count.rate for count in report.bins], **dots)
            axes.axhline(0.5, color=GREY, linewidth=0.8, linestyle=":")
            _percent(axes)
        line = load_extra("matplotlib.lines").Line2D
        handles = [line([], [], **style[label]) for label in labels]
        figure.supxlabel("speed, m/s", fontsize=11)
        figure.supylabel("success", fontsize=11)
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        return _bytes(figure, fmt)


def failure_bars(reports: Sequence[DgrReport], *, most: int = 10, fmt: Format = "svg") -> bytes:
    """Draw the number of failed attempts by reason, the most frequent on top.

    Args:
        reports: Reports, one series each.
        most: Reasons to show; the rest are pooled as "other".
        fmt: Format of the image.
    """
    reasons = _shown_reasons(reports, most)
    with _drawing((8.0, 1.6 + 0.42 * max(len(reasons), 1))) as (figure, axes):
        height = 0.8 / len(reports)
        place = np.arange(len(reasons))[::-1]
        colours = (GREY, *_CURVES) if len(reports) > 1 else _CURVES
        for index, report in enumerate(reports):
            counts = [_failed_attempts(report, reason, reasons) for reason in reasons]
            offset = ((len(reports) - 1) / 2 - index) * height
            bars = axes.barh(
                place + offset, counts, height * 0.9, color=colours[index % len(colours)], label=report.label
            )
            axes.bar_label(bars, padding=3, fontsize=9)
        axes.set_yticks(place, reasons)
        axes.margins(x=0.1)
        axes.set_xlabel(f"failed attempts of {', '.join(str(report.n) for report in reports)}")
        if not reasons:
            axes.text(0.5, 0.5, "no failures", transform=axes.transAxes, ha="center", va="center")
        figure.legend(loc="outside lower center", ncols=3)
        return _bytes(figure, fmt)


def _shown_reasons(reports: Sequence[DgrReport], most: int) -> list[str]:
    """Return the reasons to show; "other" stands for the rest."""
    ranked = ranked_reasons(reports)
    return ranked if len(ranked) <= most else [*ranked[: most - 1], "other"]


def _failed_attempts(report: DgrReport, reason: str, shown: Sequence[str]) -> int:
    """Count the attempts that failed for a reason; "other" counts those for reasons that are not shown."""
    if reason == "other" and reason not in report.failures:
        return sum(count for name, count in report.failures.items() if name not in shown)
    return report.failures.get(reason, 0)


def _bars(bins: Sequence[Count]) -> tuple[list[float], list[list[float]]]:
    """Return the heights of the bars, and how far their error bars reach below and above."""
    heights = [0.0 if math.isnan(count.rate) else count.rate for count in bins]
    intervals = [count.interval if count.n else (0.0, 0.0) for count in bins]
    below = [max(height - low, 0.0) for height, (low, _) in zip(heights, intervals, strict=True)]
    above = [max(high - height, 0.0) for height, (_, high) in zip(heights, intervals, strict=True)]
    return heights, [below, above]


def _cycle(n: int) -> list[str]:
    """Return n colours of the palette, from the first again after the last."""
    return [_CURVES[index % len(_CURVES)] for index in range(n)]


def _percent(axes: Any) -> None:
    """Let the vertical axis run from 0 to 100 %."""
    axes.yaxis.set_major_formatter(load_extra("matplotlib.ticker").PercentFormatter(1.0))
    axes.set_ylim(0.0, 1.0)


@contextmanager
def _drawing(size: tuple[float, float], grid: tuple[int, int] | None = None) -> Iterator[tuple[Any, Any]]:
    """Yield a styled figure of a size in inches, and its axes; an array of them, with a grid of rows and columns."""
    with load_extra("matplotlib").rc_context(_STYLE):
        figure = load_extra("matplotlib.figure").Figure(figsize=size, layout="constrained")
        load_extra("matplotlib.backends.backend_agg").FigureCanvasAgg(figure)
        yield figure, figure.add_subplot() if grid is None else figure.subplots(*grid, squeeze=False)


def _bytes(figure: Any, fmt: Format) -> bytes:
    buffer = io.BytesIO()
    metadata = {"Date": None} if fmt == "svg" else None  # so that equal data give equal bytes
    figure.savefig(buffer, format=fmt, dpi=100, metadata=metadata)
    return buffer.getvalue()
