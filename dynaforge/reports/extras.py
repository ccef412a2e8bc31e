"""Optional packages, imported when a report needs them."""

from __future__ import annotations

import importlib
from typing import Any


def load_extra(module: str, *, extra: str = "report") -> Any:
    """Import a module that one of the package's extras brings.

    Raises:
        ImportError: It is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.split(".")[0]
        raise ImportError(f"This needs {package!r}. Install it with: pip install 'dynaforge[{extra}]'") from error
