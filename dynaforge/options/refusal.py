"""How a value is refused, and how a message quotes what is long."""

from __future__ import annotations

import argparse

Refused = argparse.ArgumentTypeError
"""What the type of an option raises; its message continues the option's name."""


def shortened(text: str, longest: int = 60) -> str:
    """Return a text with its middle cut out where it is too long for one line."""
    return text if len(text) <= longest else f"{text[: longest - 10]}...{text[-7:]}"
