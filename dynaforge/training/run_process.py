"""The process that makes a run, and runs in such processes on this machine."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from dynaforge.training.run import END_WITH_STDIN
from dynaforge.training.run_pool import News
from dynaforge.training.run_spec import RunSpec

LOG = "log.txt"
"""What a run printed on stderr; it is removed when the run is finished."""

RunProcess = subprocess.Popen[str]


def start_run(spec: RunSpec) -> RunProcess:
    """Start the process that makes or resumes a run; it ends when its stdin is closed.

    Args:
        spec: The run; what goes wrong is logged in its folder.
    """
    with new_log(spec.folder).open("x") as log:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "dynaforge.training.run", spec.to_json(), END_WITH_STDIN],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,
        )


def new_log(folder: Path) -> Path:
    """Return where the log of a run belongs, with its folder in place and no earlier log."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOG
    path.unlink(missing_ok=True)  # a link would lead out of the folder, which may be a stranger's
    return path


def progress_of(process: RunProcess) -> Iterator[dict[str, Any]]:
    """Yield what a run reports until it has ended."""
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout as lines:
        for line in lines:
            if line.startswith("{"):
                yield json.loads(line)
    process.wait()


def why_it_failed(status: int, log: Path) -> str:
    """Return how a run ended that did not finish, after "RUN failed": its status and the last line of its log."""
    last = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:] or ["no message"]
    return f" with status {status}: {last[0]} (all of it in {log})"


class LocalRuns:
    """Runs in processes of this machine, one run each; they resume what an interruption left.

    Args:
        specs: Runs to make, in order.
        size: Processes at a time.
    """

    def __init__(self, specs: Sequence[RunSpec], size: int) -> None:
        self._waiting, self._size = list(specs), size
        self._running: dict[Path, RunProcess] = {}
        self._messages: queue.Queue[tuple[RunSpec, dict[str, Any] | None]] = queue.Queue()

    @property
    def left(self) -> int:
        """Number of runs that have not ended."""
        return len(self._waiting) + len(self._running)

    def news(self, seconds: float) -> list[News]:
        """Wait until there is news of a run, but not longer than this."""
        while self._waiting and len(self._running) < self._size:
            spec = self._waiting.pop(0)
            self._running[spec.folder] = start_run(spec)
            threading.Thread(target=self._listen, args=(spec, self._running[spec.folder]), daemon=True).start()
        try:
            spec, message = self._messages.get(timeout=seconds)
        except queue.Empty:
            return []
        return [(spec, self._end(spec) if message is None else message)]

    def stop(self) -> None:
        """End the runs in progress; the same specs resume them."""
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            process.wait()

    def _listen(self, spec: RunSpec, process: RunProcess) -> None:
        for message in progress_of(process):
            self._messages.put((spec, message))
        self._messages.put((spec, None))

    def _end(self, spec: RunSpec) -> str:
        status, log = self._running.pop(spec.folder).wait(), spec.folder / LOG
        if status:
            return why_it_failed(status, log)
        log.unlink()
        return ""
