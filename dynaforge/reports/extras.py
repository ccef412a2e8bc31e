"""Optional packages, imported when a report needs them."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from typing import Any


def load_extra(module: str, *, extra: str = "report") -> Any:
    """Import a module that is installed with one of the package's extras.

    Args:
        module: Name of the module.
        extra: Name of the extra.

    Raises:
        ImportError: It is not installed; the message says how to install it.
    """
    try:
        if module.startswith("matplotlib") and "matplotlib" not in sys.modules:
            _import_matplotlib()
        return importlib.import_module(module)
    except ImportError as error:
        package = module.split(".")[0]
        raise ImportError(f"This needs {package!r}. Install it with: pip install 'dynaforge[{extra}]'") from error


def _import_matplotlib() -> None:
    """Import matplotlib even where it would refuse MPLBACKEND: a notebook may set a backend of another environment."""
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        matplotlib = importlib.import_module("matplotlib")
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend:
        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = backend
