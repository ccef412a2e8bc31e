"""What `evaluate` and `table1` stored of a task, read back: for each generator its rate and what an attempt costs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

from dynaforge.demos.untrusted import MALFORMED_FILE_ERRORS, DamagedFileError, read_json
from dynaforge.evaluation import DgrReport
from dynaforge.evaluation.dgr import Count
from dynaforge.tasks import Task
from dynaforge.tasks.digest import task_digest


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredEvaluation:
    """The attempts of one generator on one task, as a file tells them.

    Attributes:
        task: Name of the task.
        generator: Name of the generator.
        count: Successes among all attempts.
        seconds: CPU-seconds of an attempt, mean over all attempts whose time is known; NaN where none is.
        definition: Digest of the task's definition, its setting included.
        path: The file.
    """

    task: str
    generator: str
    count: Count
    seconds: float
    definition: str
    path: Path

    def check(self, task: Task) -> None:
        """Check that it is of a task as it is now, in its setting, and that it tells what an attempt costs.

        Raises:
            ValueError: It is not, or does not; the message names the file.
        """
        if self.definition != task_digest(task):
            raise ValueError(
                f"{self.path} was measured with another definition of {self.task!r}, or under another setting than "
                f"{task.setting}. Choose the setting that it was measured under, or measure again."
            )
        if math.isnan(self.seconds):
            raise ValueError(
                f"{self.path} does not tell the processor time of attempts by {self.generator!r}, since it was "
                "measured before that was stored. Measure again."
            )


def read_evaluations(paths: Iterable[Path]) -> list[StoredEvaluation]:
    """Read files of `dynaforge evaluate`, or of pairs of `dynaforge table1`, each with the attempts at one task.

    Args:
        paths: The files, which may be a stranger's.

    Raises:
        FileNotFoundError: One is missing.
        DamagedFileError: One is no such file, or was changed.
        ValueError: Two of them tell of the same generator on the same task.
    """
    found: dict[tuple[str, str], StoredEvaluation] = {}
    for evaluation in (evaluation for path in paths for evaluation in _read(path)):
        first = found.setdefault((evaluation.generator, evaluation.task), evaluation)
        if first is not evaluation:
            raise ValueError(
                f"{first.path} and {evaluation.path} both tell of {evaluation.generator!r} on {evaluation.task!r}; "
                "give one of them."
            )
    return list(found.values())


def _read(path: Path) -> list[StoredEvaluation]:
    data = read_json(path, remedy="measure")
    try:
        if "identity" in data:
            return [_pair(path, data)]
        return [_evaluation(path, data, DgrReport.from_dict(report)) for report in data["reports"]]
    except MALFORMED_FILE_ERRORS as error:
        reason = f"it is no evaluation of one task ({type(error).__name__}: {error})"
        raise DamagedFileError(path, reason, remedy="measure") from error


def _evaluation(path: Path, data: Mapping[str, Any], report: DgrReport) -> StoredEvaluation:
    seconds = data.get("cpu_seconds", {}).get(report.label, [])
    known = [float(each) for each in seconds if each is not None]
    found = StoredEvaluation(
        task=str(data["task"]),
        generator=report.label,
        count=report.total,
        seconds=mean(known) if known else math.nan,
        definition=str(data["task_definition"]),
        path=path,
    )
    return _checked(found, len(data["conditions"]))


def _pair(path: Path, data: Mapping[str, Any]) -> StoredEvaluation:
    """Return the attempts of a pair of `dynaforge table1`."""
    attempts, identity = data["attempts"], data["identity"]
    seconds = [float(attempt["cpu_seconds"]) for attempt in attempts if attempt.get("cpu_seconds") is not None]
    found = StoredEvaluation(
        task=str(data["task"]),
        generator=str(data["row"]),
        count=Count(sum(attempt["success"] is True for attempt in attempts), len(attempts)),
        seconds=mean(seconds) if seconds else math.nan,
        definition=str(data["definition"]),
        path=path,
    )
    if found.count.n < identity["blocks"] * identity["attempts"]:
        raise ValueError("its attempts ended early, so that their rate leans to one side; make up the missing ones")
    return _checked(found, len(attempts))


def _checked(found: StoredEvaluation, n: int) -> StoredEvaluation:
    counts_fit = 0 <= found.count.successes <= found.count.n == n
    if not counts_fit or not found.count.n or found.seconds < 0.0:
        raise ValueError("its counts contradict each other")
    return found
