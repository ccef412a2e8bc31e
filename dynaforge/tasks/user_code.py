"""Imports files of code that a user names on the command line, and reports their mistakes in one line."""

from __future__ import annotations

import sys
import traceback
from importlib import import_module
from pathlib import Path
from types import ModuleType


def module_of_file(path: Path) -> ModuleType:
    """Import a file as a module named after it, so that workers find it too.

    Raises:
        ValueError: The name is taken or cannot be imported, or the code fails; names the file, the line and the reason.
    """
    if "." in path.stem:
        raise ValueError(
            f"{path}: Python cannot import a file with a dot in its name; "
            f"rename it to {path.stem.replace('.', '_')}.py."
        )
    if (known := sys.modules.get(path.stem)) is not None and getattr(known, "__file__", None) != str(path):
        raise ValueError(f"{path.name}: a module {path.stem!r} already exists; give the file another name.")
    if str(path.parent) not in sys.path:
        sys.path.insert(0, str(path.parent))
    try:
        return import_module(path.stem)
    except SyntaxError as error:
        line = f", line {error.lineno}" if error.lineno else ""
        raise ValueError(f"{error.filename or path}{line}: {error.msg}.") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a user's file may raise anything, and must not end the command
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        place = f"{path}, line {lines[-1]}" if lines else str(path)
        raise ValueError(f"{place}: {in_one_line(error)}") from error


def in_one_line(error: BaseException) -> str:
    """Return on one line what user code raised: the error's text, with its type unless the text is meant for users."""
    text = " ".join(str(error).split())
    if isinstance(error, SystemExit):
        return f"it ends the program (SystemExit {text}); code that is imported or called here must not."
    if isinstance(error, (ValueError, OSError)) and text:
        return text
    return f"{type(error).__name__}: {text}".removesuffix(": ")
