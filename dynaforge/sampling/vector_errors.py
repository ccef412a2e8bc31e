"""Errors of the vectorised env: what went wrong, in which worker, env and episode."""

from __future__ import annotations

import signal


class WorkerError(RuntimeError):
    """Something went wrong in a worker of the vectorised env.

    Attributes:
        worker: Index of the worker.
        env_index: Index of the env it was in; None if it was in none.
        condition: Description of what that env was running: the condition's id, else seed or reset arguments.
    """

    def __init__(self, message: str, *, worker: int, env_index: int | None, condition: str) -> None:
        super().__init__(message)
        self.worker = worker
        self.env_index = env_index
        self.condition = condition


class WorkerDied(WorkerError):  # noqa: N818  the name says what happened
    """A worker has died, or gave no answer within the time limit and was killed.

    The vectorised env can only be closed.
    """


class WorkerFailed(WorkerError):  # noqa: N818  the name says what happened
    """An env raised an exception; the cause holds the worker's traceback. The vectorised env can be reset or closed.

    Attributes:
        error_type: Name of the exception type that the env raised.
    """

    def __init__(self, message: str, *, worker: int, env_index: int | None, condition: str, error_type: str) -> None:
        super().__init__(message, worker=worker, env_index=env_index, condition=condition)
        self.error_type = error_type


class RemoteTraceback(Exception):  # noqa: N818  a traceback that serves as a cause, not an error of its own
    """The traceback of an exception in a worker, as text."""

    def __str__(self) -> str:
        return "\n" + str(self.args[0])


def exit_reason(exitcode: int | None) -> str:
    """Describe how a process ended."""
    if exitcode is None:
        return "exit status unknown"
    if exitcode >= 0:
        return f"exit status {exitcode}"
    memory = "; the system may be short of memory" if exitcode == -signal.SIGKILL else ""
    return f"killed by {signal.Signals(-exitcode).name}{memory}"
