"""Options that are numbers: counts, seeds, shares of work and spans of time."""

from __future__ import annotations

import math
import re

from dynaforge.algos.options import LARGEST_SEED
from dynaforge.options.refusal import Refused, shortened
from dynaforge.sim.checks import quoted

LARGEST_COUNT = 10**9  # of anything that is counted; more is taken for a typo


class WholeNumber:
    """A whole number in ASCII digits, from `minimum` to `maximum`.

    Args:
        minimum: The smallest number that is accepted.
        maximum: The largest number that is accepted.
    """

    def __init__(self, minimum: int = 1, maximum: int = LARGEST_COUNT) -> None:
        self.minimum, self.maximum = minimum, maximum

    def __call__(self, text: str) -> int:
        """Return the number."""
        if not re.fullmatch(r"[+-]?[0-9]+", text):
            raise Refused(f"is {quoted(text)}; it must be a whole number of at least {self.minimum}.")
        digits = text.lstrip("+-0") or "0"
        # Python converts at most 4300 digits, so a number that long is replaced by one that is out of range as well.
        value = int(text) if len(digits) < 30 else LARGEST_COUNT**4 * (-1 if text[0] == "-" else 1)
        if value < self.minimum:
            raise Refused(f"is {shortened(text)}; it must be at least {self.minimum}.")
        if value > self.maximum:
            raise Refused(f"is {shortened(text)}; it must be at most {self.maximum}.")
        return value


SEED = WholeNumber(0, LARGEST_SEED)


class Number:
    """A finite number in ASCII digits, within bounds.

    Args:
        minimum: The smallest number that is accepted.
        maximum: The largest number that is accepted.
        above: A number that must be exceeded.
    """

    def __init__(self, minimum: float = -math.inf, maximum: float = math.inf, *, above: float = -math.inf) -> None:
        self.minimum, self.maximum, self.above = minimum, maximum, above

    def __call__(self, text: str) -> float:
        """Return the number."""
        if not re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", text) or math.isinf(float(text)):
            raise Refused(f"is {quoted(text)}; it must be a finite number.")
        value = float(text)
        if value < self.minimum:
            raise Refused(f"is {shortened(text)}; it must be at least {self.minimum:g}.")
        if value <= self.above:
            raise Refused(f"is {shortened(text)}; it must be more than {self.above:g}.")
        if value > self.maximum:
            raise Refused(f"is {shortened(text)}; it must be at most {self.maximum:g}.")
        return value


def shard(text: str) -> tuple[int, int]:
    """Return (I, N) for "I/N", which means every Nth item from the I-th on, counted from 0."""
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    if not found or int(found[1]) >= int(found[2]):
        raise Refused(f"{quoted(text)} is no shard; write 0/4, 1/4, 2/4 or 3/4 for a quarter.")
    return int(found[1]), int(found[2])


def minutes(text: str) -> float:
    """Return the minutes of a span such as "90s", "10m", "1.5h", or of a bare number of minutes."""
    units = {"s": 1 / 60, "m": 1.0, "h": 60.0}
    number, unit = (text[:-1], units[text[-1]]) if text[-1:] in units else (text, 1.0)
    try:
        return Number(above=0, maximum=LARGEST_COUNT)(number) * unit
    except Refused:
        raise Refused(f"{quoted(text)} is no span of time; write 90s, 10m or 1.5h.") from None
