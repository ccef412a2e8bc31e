"""Several training runs at a time, each in a process of its own."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from dynaforge.training.run import END_WITH_STDIN
from dynaforge.training.run_spec import RunSpec

LONGEST_WAIT = 5.0  # seconds between two looks at the deadline


class RunPool:
    """Processes that make runs, one run each, a limited number at a time.

    Args:
        specs: Runs to make, in order.
        size: Processes at a time.
        seconds: Wall time after which they are stopped; what they have stored stays.
    """

    def __init__(self, specs: Sequence[RunSpec], size: int, *, seconds: float) -> None:
        self._waiting = list(specs)
        self._size = size
        self._deadline = time.monotonic() + seconds
        self._messages: queue.Queue[tuple[RunSpec, dict[str, Any] | None]] = queue.Queue()
        self._running: dict[Path, subprocess.Popen[str]] = {}
        self._steps: dict[Path, int] = {}
        self._texts: dict[Path, str] = {}
        self._failures: list[str] = []

    def work(self) -> bool:
        """Make the runs.

        Returns:
            Whether all of them were finished; False when time ran out, at Ctrl-C, or when a run failed.
        """
        total, n_runs, finished = sum(spec.steps for spec in self._waiting), len(self._waiting), 0
        with tqdm(total=total, unit="step", unit_scale=True, smoothing=0.02, dynamic_ncols=True, mininterval=1) as bar:
            try:
                while self._waiting or self._running:
                    self._start_waiting()
                    try:
                        spec, message = self._messages.get(timeout=self._until_deadline())
                    except queue.Empty:
                        if time.monotonic() >= self._deadline:
                            return False
                        continue
                    if message is None:
                        finished += self._end(spec, bar)
                    else:
                        self._show_progress(spec, message, bar)
                    bar.set_description_str(f"{finished} of {n_runs} runs", refresh=False)
                    bar.set_postfix_str(" | ".join(self._texts.values()), refresh=False)
                    bar.update(0)
            except KeyboardInterrupt:
                return False
            finally:
                self._stop()
        for line in self._failures:
            print(line, file=sys.stderr)
        return not self._failures

    def _until_deadline(self) -> float:
        return min(LONGEST_WAIT, max(0.0, self._deadline - time.monotonic()))

    def _start_waiting(self) -> None:
        while self._waiting and len(self._running) < self._size:
            self._start(self._waiting.pop(0))

    def _start(self, spec: RunSpec) -> None:
        spec.folder.mkdir(parents=True, exist_ok=True)
        path = spec.folder / "log.txt"
        path.unlink(missing_ok=True)  # a link would lead out of the folder, which may be a stranger's
        with path.open("x") as log:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "dynaforge.training.run", spec.to_json(), END_WITH_STDIN],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,
            )
        self._running[spec.folder] = process
        threading.Thread(target=self._read_messages, args=(spec, process), daemon=True).start()

    def _read_messages(self, spec: RunSpec, process: subprocess.Popen[str]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        with process.stdin, process.stdout as lines:
            for line in lines:
                if line.startswith("{"):
                    self._messages.put((spec, json.loads(line)))
        self._messages.put((spec, None))

    def _show_progress(self, spec: RunSpec, message: dict[str, Any], bar: Any) -> None:
        before = self._steps.get(spec.folder, 0)
        self._steps[spec.folder] = message.get("steps", before)
        bar.update(self._steps[spec.folder] - before)
        self._texts[spec.folder] = f"{Path(spec.task).stem}/{spec.variant}/{spec.seed} {message['text']}"

    def _end(self, spec: RunSpec, bar: Any) -> bool:
        process = self._running.pop(spec.folder)
        self._texts.pop(spec.folder, None)
        process.wait()
        log = spec.folder / "log.txt"
        if process.returncode == 0:
            log.unlink()
            return True
        last = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:] or ["no message"]
        self._failures.append(f"{spec.folder} failed with status {process.returncode}: {last[0]} (all of it in {log})")
        bar.write(self._failures[-1])
        return False

    def _stop(self) -> None:
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            process.wait()
