"""Defers Ctrl-C and SIGTERM over a few lines that must run whole or not at all."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def signals_deferred() -> Iterator[None]:
    """Run Python's handlers of Ctrl-C and SIGTERM after the block instead of inside it.

    Python runs them in the main thread only, so in any other thread there is nothing to do. Keep the block short: while
    it lasts, the process cannot be interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: dict[int, FrameType | None] = {}
    handlers = {number: handler for number in SIGNALS if callable(handler := signal.getsignal(number))}
    try:
        for number in handlers:
            signal.signal(number, received.setdefault)
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for deferred, frame in received.items():
            handlers[signal.Signals(deferred)](deferred, frame)
