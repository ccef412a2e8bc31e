"""Options that are paths: a file or a folder to read, or one to write. Nothing is created here."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from dynaforge.options.refusal import Refused, shortened
from dynaforge.sim.checks import quoted

Kind = Literal["file", "folder"]


class ExistingPath:
    """A file or a folder that exists and can be read.

    Args:
        kind: "file" or "folder".
        containing: A file that the folder must contain.
        complaint: What the message says of a folder without that file, such as "holds no demonstrations".
    """

    def __init__(self, kind: Kind, *, containing: str = "", complaint: str = "") -> None:
        self.kind, self.containing, self.complaint = kind, containing, complaint

    def __call__(self, text: str) -> Path:
        """Return the path."""
        path = _path(text)
        mode = _mode(path)
        if mode is None:
            raise Refused(f"{_quoted_path(text)}: no such {self.kind}.")
        if not _is(self.kind, mode):
            raise Refused(f"{_quoted_path(text)} is a {_kind_of(mode)}; it must be a {self.kind}.")
        if not os.access(path, os.R_OK):
            raise Refused(f"{_quoted_path(text)} cannot be read: no permission.")
        if self.containing and not (path / self.containing).is_file():
            raise Refused(f"{_quoted_path(text)} {self.complaint}: it has no {self.containing}.")
        return path


class OutputPath:
    """A file or a folder to write, whose missing parent folders are created when it is written.

    Args:
        kind: "file" or "folder".
        containing: A file that an existing folder must contain, unless it is empty.
        new: Whether nothing may exist at the path yet.
    """

    def __init__(self, kind: Kind, *, containing: str = "", new: bool = False) -> None:
        self.kind, self.containing, self.new = kind, containing, new

    def __call__(self, text: str) -> Path:
        """Return the path."""
        path = _path(text)
        self._check_name(text)
        if (mode := _mode(path)) is not None:
            self._check_existing(path, mode)
        self._check_parents(path, text)
        return path

    def _check_name(self, text: str) -> None:
        if any("\udc80" <= letter <= "\udcff" for letter in text):  # how Python represents bytes that are not text
            raise Refused(f"is {quoted(text)}, no text in this locale; choose another, or set LC_ALL=C.UTF-8.")
        if not text.isprintable():
            raise Refused(f"is {quoted(text)}; a name with control characters makes no good {self.kind}.")

    def _check_existing(self, path: Path, mode: int) -> None:
        if self.new:
            raise Refused(f"{path} exists already. Choose another, or remove it.")
        if not _is(self.kind, mode):
            raise Refused(f"{path} is a {_kind_of(mode)}; it must be a {self.kind}, new or existing.")
        if not os.access(path, os.R_OK | os.W_OK):
            raise Refused(f"{path} cannot be changed: no permission. Choose another {self.kind}.")
        if self.containing and not (path / self.containing).is_file():
            others = sorted(entry.name for entry in path.iterdir() if not entry.name.startswith("."))
            if others:
                listed = ", ".join(others[:3])
                raise Refused(f"{path} holds other data ({shortened(listed)}). Choose a new or empty folder.")

    def _check_parents(self, path: Path, text: str) -> None:
        chain = (path, *path.absolute().parents)
        if dangling := [p for p in chain if os.path.islink(p) and _mode(p) is None]:
            raise Refused(f"{text} cannot be made: {dangling[0]} is a link to nothing. Choose another {self.kind}.")
        nearest = next(p for p in chain if _mode(p) is not None and (p.is_dir() or p != path))
        if not nearest.is_dir():
            raise Refused(f"{text} cannot be made: {nearest} is a file. Choose another {self.kind}.")
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise Refused(f"{text} cannot be made: {nearest} is not writable. Choose another {self.kind}.")


def _path(text: str) -> Path:
    if not text or "\0" in text:
        raise Refused(f"is {quoted(text)}; it must be a path.")
    return Path(text)


def _quoted_path(text: str) -> str:
    """Return a path as a message should name it."""
    return text if text.isprintable() and len(text) < 1000 else quoted(text)


def _mode(path: Path) -> int | None:
    """Return the file mode at a path; None where nothing exists."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise Refused(f"{_quoted_path(str(path))} cannot be used: {error.strerror}.") from error


_TESTS: dict[Kind, Callable[[int], bool]] = {"file": stat.S_ISREG, "folder": stat.S_ISDIR}


def _is(kind: Kind, mode: int) -> bool:
    return _TESTS[kind](mode)


def _kind_of(mode: int) -> str:
    return next((kind for kind, test in _TESTS.items() if test(mode)), "device")
