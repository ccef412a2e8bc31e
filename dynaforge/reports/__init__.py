"""Reports: figures, films, and HTML pages that contain them. Their functions need the `[report]` extra."""

from dynaforge.reports.comparison import task_figures, write_comparison
from dynaforge.reports.html import Clip, ReportData, ReportFigure, render_report, write_report
from dynaforge.reports.plots import dgr_by_difficulty, failure_bars, learning_curve, probe_curve, stratum_heatmap
from dynaforge.reports.video import contact_sheet, encode_gif, encode_mp4, encode_png

__all__ = [
    "Clip",
    "ReportData",
    "ReportFigure",
    "contact_sheet",
    "dgr_by_difficulty",
    "encode_gif",
    "encode_mp4",
    "encode_png",
    "failure_bars",
    "learning_curve",
    "probe_curve",
    "render_report",
    "stratum_heatmap",
    "task_figures",
    "write_comparison",
    "write_report",
]
