"""Optional packages of the `[report]` extra, imported when a report needs them."""

from __future__ import annotations

import importlib
from typing import Any


def load_extra(module: str) -> Any:
    """Import a module of the `[report]` extra.

    Raises:
        ImportError: It is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.split(".")[0]
        raise ImportError(f"Reports need {package!r}. Install it with: pip install 'dynaforge[report]'") from error
