"""A row of numbers as one short word of bars."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

BARS = "▁▂▃▄▅▆▇█"


def sparkline(shares: Iterable[float]) -> str:
    """Draw numbers within [0, 1] as bars; a blank for NaN."""
    return "".join(" " if np.isnan(share) else BARS[round(float(share) * (len(BARS) - 1))] for share in shares)
