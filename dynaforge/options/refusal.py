"""The exception with which a value is refused, and how its message shortens long values."""

from __future__ import annotations

import argparse

Refused = argparse.ArgumentTypeError
"""Raised by the type of an option; its message continues the option's name."""


def shortened(text: str, longest: int = 60) -> str:
    """Return a text, without its middle if it is too long for one line."""
    return text if len(text) <= longest else f"{text[: longest - 10]}...{text[-7:]}"
