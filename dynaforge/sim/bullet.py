"""PyBullet without the lines it prints to the terminal on import and at every connection."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any

__all__ = ["connect", "pybullet"]


@contextlib.contextmanager
def _silent_terminal() -> Iterator[None]:
    """Point stdout and stderr of the whole process elsewhere: Bullet prints from C, below Python's streams."""
    sys.stdout.flush()
    kept = [os.dup(fd) for fd in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd in (1, 2):
            os.dup2(nowhere, fd)
        yield
    finally:
        for fd, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, fd)
            os.close(copy)
        os.close(nowhere)


with _silent_terminal():
    import pybullet
    from pybullet_utils.bullet_client import BulletClient


def connect(*, gui: bool = False) -> Any:
    """Open a physics client of its own, with Bullet's window or without."""
    with _silent_terminal():
        return BulletClient(connection_mode=pybullet.GUI if gui else pybullet.DIRECT)
