"""Options that are words: one of several names, or one line of text."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from dynaforge.options.refusal import Refused
from dynaforge.sim.checks import close_match, quoted

FILE_NAME_PART = r"[A-Za-z0-9][A-Za-z0-9_.-]*"
"""Pattern of a text that becomes part of a file's name."""


class Choice:
    """One of several names; a typo is refused with the closest of them.

    Args:
        kind: What the names are names of, for the message.
        names: The names.
    """

    def __init__(self, kind: str, names: Iterable[str]) -> None:
        self.kind, self.names = kind, tuple(names)

    def __call__(self, text: str) -> str:
        """Return the name."""
        if text not in self.names:
            hint = close_match(text, self.names)
            raise Refused(f": No {self.kind} {quoted(text)}.{hint} Known are {', '.join(self.names)}.")
        return text


def one_of(kind: str, names: Iterable[str]) -> dict[str, Any]:
    """Return the keywords of `add_argument` for an option with few possible values, which `--help` then lists."""
    listed = tuple(names)
    return {"type": Choice(kind, listed), "choices": listed}


class Text:
    """One line of text that matches a pattern, such as text that is written to files as it is.

    Args:
        description: What the text must be, for the message.
        pattern: A regular expression that the whole text must match.
        longest: Number of characters at most.
    """

    def __init__(self, description: str, pattern: str, *, longest: int = 200) -> None:
        self.description, self.pattern, self.longest = description, pattern, longest

    def __call__(self, text: str) -> str:
        """Return the text."""
        if len(text) > self.longest or not re.fullmatch(self.pattern, text):
            raise Refused(f"is {quoted(text)}; it must be {self.description}.")
        return text
