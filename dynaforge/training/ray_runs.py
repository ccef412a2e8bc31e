"""Training runs on an existing Ray cluster; no folder need be shared, since their files come back as bytes."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dynaforge.files.atomic import atomic_write
from dynaforge.geometry import one_line
from dynaforge.sampling.ray_cluster import cluster_cores
from dynaforge.sampling.ray_jobs import RayJobs
from dynaforge.training.run_archive import EVALUATED
from dynaforge.training.run_pool import News
from dynaforge.training.run_process import LOG, RunProcess, new_log, progress_of, start_run, why_it_failed
from dynaforge.training.run_spec import RunSpec
from dynaforge.training.stored_training import CHECKPOINT


@dataclass(frozen=True, slots=True)
class MadeRun:
    """A run that has ended on some node.

    Attributes:
        spec: The run.
        status: Exit status of its process.
        files: Name and content of the files that it left: of a finished run all, else the log.
        problem: Why no process could make it; "" if one did.
    """

    spec: RunSpec
    status: int
    files: dict[str, bytes] = field(default_factory=dict)
    problem: str = ""

    __repr__ = one_line

    def store(self) -> str:
        """Write the files into the folder of the run, the one that marks it as finished last; return why it failed.

        What an earlier, interrupted run left there is replaced.

        Raises:
            OSError: They cannot be written.
        """
        log = new_log(self.spec.folder)
        for name in sorted(self.files, key=lambda name: name == EVALUATED):
            atomic_write(self.spec.folder / name, self.files[name])
        if self.problem:
            return f": {self.problem}"
        if self.status:
            return why_it_failed(self.status, log)
        (self.spec.folder / CHECKPOINT).unlink(missing_ok=True)
        return ""


class RunMaker:
    """Makes runs on a node, each in a process of its own and in a temporary folder."""

    def __init__(self) -> None:
        self._progress: dict[str, Any] = {}
        self._process: RunProcess | None = None
        self._at_work = threading.Lock()

    def __call__(self, spec: RunSpec) -> MadeRun:
        """Make a run from the beginning.

        Args:
            spec: The run; its folder is the one at the driver.
        """
        with self._at_work, tempfile.TemporaryDirectory(prefix="dynaforge-") as top:
            folder = Path(top) / spec.variant / spec.folder.name
            self._process = start_run(replace(spec, folder=folder))
            for message in progress_of(self._process):
                self._progress = message
            status, self._progress = self._process.wait(), {}
            names = {LOG} if status else {path.name for path in folder.iterdir()} - {LOG}
            return MadeRun(spec, status, {name: (folder / name).read_bytes() for name in names})

    def progress(self) -> dict[str, Any]:
        """Return what the run in progress reported last."""
        return self._progress

    def stop(self) -> None:
        """End the run in progress and wait until its temporary folder is gone."""
        if self._process is not None:
            self._process.terminate()
        with self._at_work:
            pass


class RayRuns:
    """Runs on the nodes of a Ray cluster, one core each.

    A run on a node that is lost begins again on another; so does a run that was interrupted, since checkpoints stay on
    the node.

    Args:
        specs: Runs to make, in order.
        size: Runs at a time; by default one per core of the cluster.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
    """

    def __init__(self, specs: Sequence[RunSpec], size: int | None = None) -> None:
        self._waiting, self.left = iter(specs), len(specs)
        size = min(size or cluster_cores(), len(specs))
        self._jobs = RayJobs(RunMaker, failed=_lost, size=size, queued=1, answering=True)

    def news(self, seconds: float) -> list[News]:
        """Wait until a run has ended, but not longer than this; return that, or how far the others are.

        Raises:
            NoWorkers: No actor has been ready for a long time.
        """
        self._jobs.hand_out(self._waiting)
        self._jobs.wait(seconds)
        ended: list[News] = []
        for made in self._jobs.finished():
            ended.append((made.spec, made.store()))
            self.left -= 1
        return ended or [(spec, progress) for spec, progress in self._jobs.ask("progress") if progress]

    def stop(self) -> None:
        """End the runs in progress."""
        self._jobs.ask("stop")
        self._jobs.kill()


def _lost(spec: RunSpec, problem: str) -> MadeRun:
    return MadeRun(spec, 1, problem=problem)
