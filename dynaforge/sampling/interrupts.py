"""Puts off Ctrl-C over a few lines that must be carried out whole or not at all."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def put_off() -> Iterator[None]:
    """Let handlers of Ctrl-C and SIGTERM that are written in Python run after the block instead of inside it.

    They run in the main thread only, so in another there is nothing to do. A block has to be short: while it lasts,
    the process cannot be interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: dict[int, FrameType | None] = {}
    handlers = {number: handler for number in SIGNALS if callable(handler := signal.getsignal(number))}
    try:
        for number in handlers:
            signal.signal(number, came.setdefault)
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for came_first, frame in came.items():
            handlers[signal.Signals(came_first)](came_first, frame)
