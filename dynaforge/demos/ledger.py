"""The ledger: one line for every attempt, so that the success rate has an honest denominator."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import zlib
from collections.abc import Iterator
from pathlib import Path

from dynaforge.demos.episode import Attempt
from dynaforge.demos.untrusted import MALFORMED_FILE_ERRORS, open_file, parse_json
from dynaforge.files.atomic import errors_naming
from dynaforge.sim.checks import check_flag, check_kind

LONGEST = 2**31  # bytes of the largest ledger that is read: millions of attempts
LINE = 2**20  # bytes of the longest line


class Ledger:
    """An append-only file of attempts, one JSON line each; any number of processes may write to it.

    A line is one O_APPEND write and ends with its own checksum. A line torn by a kill or altered later is skipped when
    reading, and reported by `read`.

    Args:
        path: The file; it need not exist.
        fsync: Whether `append` waits until the line is on disk.
    """

    def __init__(self, path: str | Path, *, fsync: bool = True) -> None:
        check_kind("path", path, (str, Path))
        check_flag("fsync", fsync)
        self.path = Path(path)
        self.fsync = fsync

    def append(self, attempt: Attempt) -> None:
        """Append one line; with `fsync` it is on disk when this returns.

        Raises:
            OSError: The file is not writable or is a link, which might lead anywhere, or the disk is full.
        """
        line = _line(attempt)
        descriptor = self._open()
        try:
            size = os.fstat(descriptor).st_size
            # A killed writer may have left half a line, so begin a new one; an empty line is harmless.
            if size and os.pread(descriptor, 1, size - 1) != b"\n":
                line = b"\n" + line
            with errors_naming(self.path):
                if os.write(descriptor, line) != len(line):
                    raise OSError(errno.ENOSPC, "only part of a ledger line could be written")
                if self.fsync:
                    os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def _open(self) -> int:
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
        try:
            return os.open(self.path, flags, 0o666)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise OSError(errno.ELOOP, "a ledger that is a link is not written to", str(self.path)) from error
            raise

    def attempts(self) -> list[Attempt]:
        """Return the attempts in the order of writing; of several with the same id, the first.

        Raises:
            DamagedFileError: The file cannot be read at all.
        """
        return self.read()[0]

    def read(self) -> tuple[list[Attempt], list[int]]:
        """Return the attempts, and the numbers, from 1, of the lines that were torn or altered.

        Raises:
            DamagedFileError: As `attempts`.
        """
        found: dict[str, Attempt] = {}
        damaged: list[int] = []
        for number, line in enumerate(self._lines(), 1):
            attempt = _parse(line)
            if attempt is not None:
                found.setdefault(attempt.id, attempt)
            elif line:
                damaged.append(number)
        return list(found.values()), damaged

    def _lines(self) -> Iterator[bytes]:
        with contextlib.suppress(FileNotFoundError), open_file(self.path, at_most=LONGEST) as file:
            while line := file.readline(LINE):
                yield line.removesuffix(b"\n")


def _line(attempt: Attempt) -> bytes:
    text = json.dumps(attempt.to_dict(), sort_keys=True)
    return f'{{"attempt": {text}, "crc": {zlib.crc32(text.encode())}}}\n'.encode()


def _parse(line: bytes) -> Attempt | None:
    try:
        record = parse_json(line)
        attempt = Attempt.from_dict(record["attempt"])
        return attempt if _line(attempt) == line + b"\n" else None  # only a line as `append` writes it
    except MALFORMED_FILE_ERRORS:
        return None
