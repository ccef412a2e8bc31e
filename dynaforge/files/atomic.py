"""Files that are complete or absent: the one place for "temporary name, fsync, rename"."""

from __future__ import annotations

import contextlib
import os
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

_TEMPORARY = ".tmp"


def atomic_write(path: str | Path, content: bytes | Callable[[Path], None]) -> None:
    """Put a file in place in one step: a reader, or a kill at any instant, sees the old file or the new one.

    The content is written under a hidden temporary name in the same folder and forced to disk, the file is renamed, and
    the folder is forced to disk too. If anything fails, the temporary file is removed.

    Args:
        path: Final name. Its folder must exist.
        content: The bytes, or a function that writes the whole file at the temporary path that it is given. That path
            has the final suffix (`.zip`, `.h5`), because some libraries choose the format by it or append their own.

    Raises:
        OSError: The folder is missing or not writable, or the disk is full.
    """
    final = Path(path)
    temporary = final.with_name(f".{uuid.uuid4().hex}{_TEMPORARY}{final.suffix}")
    try:
        with errors_naming(final):
            if callable(content):
                content(temporary)
                _sync(temporary, os.O_RDWR)
            else:
                _write_bytes(temporary, content)
        os.replace(temporary, final)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(final.parent)


@contextlib.contextmanager
def errors_naming(path: Path) -> Iterator[None]:
    """Add the name of the file to errors of calls that know only a descriptor, such as "No space left on device"."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def _write_bytes(path: Path, content: bytes) -> None:
    # O_CREAT rather than mkstemp, which would ignore the umask: files in a shared folder stay readable by the others.
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        view = memoryview(content)
        while view:
            view = view[os.write(descriptor, view) :]
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: str | Path) -> None:
    """Force the names in a folder to disk, so that a rename survives a power cut."""
    if os.name == "posix":  # Windows cannot open a folder, and does not need this
        _sync(Path(folder), os.O_RDONLY)


def is_temporary(path: str | Path) -> bool:
    """Return whether a name is one that `atomic_write` gives to unfinished files."""
    name = Path(path).name
    return name.startswith(".") and (name.endswith(_TEMPORARY) or Path(name).stem.endswith(_TEMPORARY))


def remove_stale(folder: str | Path, *, older_than: float = 3600.0) -> int:
    """Remove unfinished files that a killed writer left behind; a process may still be writing younger ones.

    Args:
        folder: Where to look, not recursively.
        older_than: Seconds since the last write after which a file counts as abandoned.

    Returns:
        The number of files removed.
    """
    removed = 0
    for path in Path(folder).iterdir():
        with contextlib.suppress(FileNotFoundError):  # its writer finished meanwhile
            if is_temporary(path) and time.time() - path.stat().st_mtime > older_than:
                path.unlink()
                removed += 1
    return removed


def check_writable(folder: str | Path) -> None:
    """Check, before any long work, that files can be created in a folder.

    Raises:
        PermissionError: They cannot be; the message names the folder.
    """
    probe = Path(folder) / f".{uuid.uuid4().hex}{_TEMPORARY}"
    try:
        _write_bytes(probe, b"probe")
    except OSError as error:
        reason = error.strerror or error
        raise PermissionError(f"Cannot write to {folder}: {reason}. Choose another folder or free this one.") from error
    finally:
        if os.path.lexists(probe):
            probe.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make the folder of `--out`, and check that it can be written to.

    Raises:
        ValueError: It cannot be made.
        PermissionError: It cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"--out {folder} cannot be made: {error.strerror}. Choose another folder.") from error
    check_writable(folder)
