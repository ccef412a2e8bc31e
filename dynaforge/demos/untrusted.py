"""Reading of files that a stranger may have made: nothing hangs or fills the memory, and every error names its file."""

from __future__ import annotations

import contextlib
import json
import math
import os
import stat
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
from numpy.typing import NDArray

NOTES = 16 * 2**20  # bytes of the largest JSON file that is read
LEVELS = 32  # of nesting, in JSON
DIGITS = 300  # of a whole number in JSON, so that it can be converted to a float
LINKS = 1000  # names in an HDF5 file
FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}  # others may load code from a plugin folder
KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFDIR: "a folder",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFREG: "a file",
}
MALFORMED_FILE_ERRORS = (
    OSError,
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    ArithmeticError,
    RuntimeError,
    MemoryError,
)
"""What json, h5py and numpy may raise when they decode bytes that mean something else."""


class DamagedFileError(ValueError):
    """A file does not contain what was once written to it; the message names the file.

    Args:
        path: The file.
        reason: What is wrong with it.
        remedy: How it can be made again, once deleted.
    """

    def __init__(self, path: str | Path, reason: str, *, remedy: str = "collect") -> None:
        hint = f"Restore it from a copy, or delete it and {remedy} again."
        super().__init__(f"{printable(path)} is damaged: {reason}. {hint}")
        self.path = Path(path)
        self.reason = reason
        self.remedy = remedy

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(DamagedFileError, remedy=self.remedy), (self.path, self.reason)


def printable(text: object) -> str:
    """Return a text as one line that is safe to print: control characters and lone surrogates are escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in str(text))


def kind_of(path: Path) -> str:
    """Return what exists at a path, links followed: "a file", "a folder", "a named pipe", ...; "" for nothing."""
    try:
        return KINDS.get(stat.S_IFMT(path.stat().st_mode), "something else")
    except FileNotFoundError:
        return "a link to nothing" if path.is_symlink() else ""
    except OSError as error:
        return "a link to itself" if path.is_symlink() else f"unreadable ({error.strerror})"


def read_file(path: Path, *, at_most: int, remedy: str = "collect") -> bytes:
    """Read a whole regular file.

    Args:
        path: The file, or a link to it.
        at_most: Bytes that are read at most; a longer file is refused before it is read.
        remedy: How the file can be made again, for the message.

    Raises:
        FileNotFoundError: Nothing exists at the path.
        DamagedFileError: It is no file, cannot be read, or is too long.
    """
    with open_file(path, at_most=at_most, remedy=remedy) as file:
        try:
            return file.read()
        except MALFORMED_FILE_ERRORS as error:
            raise DamagedFileError(path, f"it cannot be read ({error})", remedy=remedy) from error


@contextlib.contextmanager
def open_file(path: Path, *, at_most: int, remedy: str = "collect") -> Iterator[BinaryIO]:
    """Open a regular file for reading bytes.

    Args:
        path: The file, or a link to it.
        at_most: Bytes that it may have at most.
        remedy: How the file can be made again, for the message.

    Raises:
        FileNotFoundError, DamagedFileError: As for `read_file`.
    """
    kind = kind_of(path)
    if not kind:
        raise FileNotFoundError(f"There is no {printable(path)}.")
    if kind != "a file":  # checked before opening, since opening a device may have an effect
        raise DamagedFileError(path, f"it is {kind}, not a file", remedy=remedy)
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise DamagedFileError(path, f"it cannot be read ({error.strerror})", remedy=remedy) from error
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise DamagedFileError(path, "it is no longer a file", remedy=remedy)
        if status.st_size > at_most:
            reason = f"it is {status.st_size / 1e6:.0f} MB long; at most {at_most / 1e6:.0f} MB are read"
            raise DamagedFileError(path, reason, remedy=remedy)
        yield file


def read_json(path: Path, *, remedy: str = "collect") -> Any:
    """Read a JSON file.

    Raises:
        FileNotFoundError, DamagedFileError: As `read_file`, or it is no JSON.
    """
    data = read_file(path, at_most=NOTES, remedy=remedy)
    try:
        return parse_json(data)
    except ValueError as error:
        raise DamagedFileError(path, f"it is no JSON ({error})", remedy=remedy) from error


def parse_json(data: bytes | str) -> Any:
    """Parse JSON with finite numbers and bounded depth.

    Raises:
        ValueError: The data is anything else.
    """
    if not data.strip():
        raise ValueError("it is empty")
    try:
        found = json.loads(data, parse_constant=_no_number, parse_int=_whole, parse_float=_finite)
    except RecursionError:
        raise ValueError(f"nested in more than {LEVELS} levels") from None
    level = [found]
    for _ in range(LEVELS):
        level = [child for item in level for child in _children(item)]
        if not level:
            return found
    raise ValueError(f"nested in more than {LEVELS} levels")


def _children(item: Any) -> Iterable[Any]:
    if isinstance(item, dict):
        return item.values()
    return item if isinstance(item, list) else ()


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number")


def _whole(text: str) -> int:
    if len(text) > DIGITS:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text[:20]} is too large a number")
    return value


def files_in(folder: Path, suffix: str = "", *, remedy: str = "collect") -> list[Path]:
    """Return the paths of everything in a folder, sorted by name; none where the folder is missing.

    Args:
        folder: The folder.
        suffix: How the names must end.
        remedy: How the folder can be made again, for the message.

    Raises:
        DamagedFileError: It is no folder, or cannot be read.
    """
    kind = kind_of(folder)
    if not kind:
        return []
    if kind != "a folder":
        raise DamagedFileError(folder, f"it is {kind}, not a folder", remedy=remedy)
    try:
        return sorted(folder / name for name in os.listdir(folder) if name.endswith(suffix))
    except OSError as error:
        raise DamagedFileError(folder, f"it cannot be read ({error.strerror})", remedy=remedy) from error


def check_links(file: Any) -> None:
    """Check that all names in an open HDF5 file stand for data in that file.

    A soft link may lead in circles, an external one out of the file: neither is ever followed.

    Raises:
        ValueError: A name stands for a link, or there are too many names.
    """
    names = 0

    def wrong(name: bytes, link: Any) -> str | None:  # HDF5 lets no exception through; a return value ends the visit
        nonlocal names
        names += 1
        if names > LINKS:
            return f"it holds more than {LINKS} names"
        if link.type != h5py.h5l.TYPE_HARD:
            return f"{printable(name.decode(errors='replace'))} is a link, not data"
        return None

    if problem := file.id.links.visit(wrong, info=True):
        raise ValueError(problem)


def read_text(file: Any, name: str) -> str:
    """Read a text attribute at the root of an open HDF5 file.

    Raises:
        ValueError: It is missing or is not a single text.
    """
    if not h5py.h5a.exists(file.id, name.encode()):
        raise ValueError(f"it has no {name}")
    attribute = h5py.h5a.open(file.id, name.encode())
    if attribute.shape != () or not isinstance(attribute.get_type(), h5py.h5t.TypeStringID):
        raise ValueError(f"its {name} is no text")
    value = file.attrs[name]
    return value if isinstance(value, str) else str(value, "utf-8")


def read_array(file: Any, name: str, *, at_most: int) -> NDArray[Any]:
    """Read an array of plain numbers from an open HDF5 file.

    Args:
        file: The file.
        name: Name of the array.
        at_most: Bytes that it may have at most.

    Raises:
        ValueError: It is missing, of another type, stored outside the file, or larger than `at_most` bytes.
    """
    data = file.get(name)
    if not isinstance(data, h5py.Dataset):
        raise ValueError(f"it has no {name}")
    layout = data.id.get_create_plist()
    if data.is_virtual or layout.get_external_count():
        raise ValueError(f"{name} lies in another file")
    if {layout.get_filter(k)[0] for k in range(layout.get_nfilters())} - FILTERS:
        raise ValueError(f"{name} is stored through an unknown filter")
    if not data.shape or any(column.kind not in "biuf" for column in _columns(data.dtype)):
        raise ValueError(f"{name} is no array of numbers")
    if data.nbytes > at_most or (layout.get_layout() != h5py.h5d.CHUNKED and data.nbytes > data.id.get_storage_size()):
        raise ValueError(f"{name} claims {data.nbytes / 1e6:.0f} MB, more than there can be")
    return np.asarray(data[()])


def _columns(dtype: np.dtype[Any]) -> Iterator[np.dtype[Any]]:
    """Yield the types of the columns of a flat table; of any other array its own type."""
    for name in dtype.names or ():
        yield dtype[name].base
    if dtype.names is None:
        yield dtype
