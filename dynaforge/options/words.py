"""Options that are words: one of some names, or one line of text."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from dynaforge.options.refusal import Refused
from dynaforge.sim.checks import close_match, quoted

FILE_NAME_PART = r"[A-Za-z0-9][A-Za-z0-9_.-]*"
"""Pattern of what becomes part of a file's name."""


class Choice:
    """One of some names; a slip is refused with the closest of them."""

    def __init__(self, what: str, names: Iterable[str]) -> None:
        self.what, self.names = what, tuple(names)

    def __call__(self, text: str) -> str:
        """Return the name."""
        if text not in self.names:
            hint = close_match(text, self.names)
            raise Refused(f": No {self.what} {quoted(text)}.{hint} Known are {', '.join(self.names)}.")
        return text


def one_of(what: str, names: Iterable[str]) -> dict[str, Any]:
    """Return the keywords of `add_argument` for an option with a few possible values, which `--help` then lists."""
    listed = tuple(names)
    return {"type": Choice(what, listed), "choices": listed}


class Text:
    """One line of text that matches a pattern, for what goes into files as it is."""

    def __init__(self, what: str, pattern: str, *, longest: int = 200) -> None:
        self.what, self.pattern, self.longest = what, pattern, longest

    def __call__(self, text: str) -> str:
        """Return the text."""
        if len(text) > self.longest or not re.fullmatch(self.pattern, text):
            raise Refused(f"is {quoted(text)}; it must be {self.what}.")
        return text
