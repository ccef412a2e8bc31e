"""Output on any terminal: characters that its encoding lacks are written in ASCII instead of raising an error."""

from __future__ import annotations

import codecs
import io
import os
import sys

from dynaforge.sampling.processes import fill_standard_descriptors
from dynaforge.training.sparkline import BARS

PLAIN = {
    **dict(zip(BARS, "_.:-=+*#", strict=True)),  # a sparkline still rises
    **dict.fromkeys("│┃▏▎▍▌▋▊▉", "|"),
    **dict.fromkeys("─━–—−", "-"),
    **dict.fromkeys("┌┬┐├┼┤└┴┘┏┳┓┣╋┫┗┻┛┡╇┩╞╪╡", "+"),
    "≥": ">=",
    "≤": "<=",
    "×": "x",
    "→": "->",
    "…": "...",
    "±": "+-",
    "°": " deg",
    "µ": "u",
    "μ": "u",
    "·": ".",
    "’": "'",
    "“": '"',
    "”": '"',
    "\u00a0": " ",
}
HANDLER = "dynaforge.plain"


def show_anything() -> None:
    """Make stdout and stderr of this process accept any text, even if they are closed."""
    fill_standard_descriptors()
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)
    codecs.register_error(HANDLER, _in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=HANDLER)


def _in_ascii(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    plain = (PLAIN.get(c) or c.encode("ascii", "backslashreplace").decode("ascii") for c in missing)
    return "".join(plain), error.end
