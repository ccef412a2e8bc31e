"""The checks of a folder of demonstrations apart from its recordings: ledger, notes, and files that do not belong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from dynaforge.demos.dataset import EPISODES, NOTES, SOURCES, DemonstrationDataset
from dynaforge.demos.episode import Attempt
from dynaforge.demos.episode_file import SUFFIX
from dynaforge.demos.observation_file import SETTINGS
from dynaforge.demos.observations import FOLDER as OBSERVATIONS
from dynaforge.demos.observations import ObservationFolder
from dynaforge.demos.provenance import Provenance
from dynaforge.demos.untrusted import DamagedFileError, files_in, kind_of, printable
from dynaforge.files.atomic import is_temporary
from dynaforge.sim import Condition
from dynaforge.tasks import Task

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Finding:
    """A problem with a file.

    Attributes:
        path: The file.
        problem: What is wrong with it.
    """

    path: Path
    problem: str

    def __str__(self) -> str:
        return printable(f"{self.path}: {self.problem}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Notes:
    """What a folder contains besides its recordings, read once.

    Attributes:
        names: Ids of the recordings.
        attempts: The attempts in the ledger, by id.
        sources: `generators.json`; None where it cannot be read.
        observations: The rendered observations; None where there are none, or their settings cannot be read.
        findings: The problems met while reading.
    """

    names: list[str] = field(default_factory=list)
    attempts: Mapping[str, Attempt] = field(default_factory=dict)
    sources: Mapping[str, Provenance] | None = None
    observations: ObservationFolder | None = None
    findings: list[Finding] = field(default_factory=list)


def read_notes(dataset: DemonstrationDataset) -> Notes:
    """Read what there is besides the recordings, each file once; what cannot be read is a finding."""
    found: list[Finding] = []

    def reading(read: Callable[[], _T]) -> _T | None:
        try:
            return read()
        except DamagedFileError as error:
            found.append(Finding(error.path, error.reason))
            return None

    names = reading(dataset.ids) or []
    attempts, damaged = reading(dataset.ledger.read) or ([], [])
    found += [Finding(dataset.ledger.path, f"line {n} was torn or altered") for n in damaged]
    sources = reading(dataset.sources)
    folder = dataset.path / OBSERVATIONS
    try:
        observations = reading(lambda: ObservationFolder(folder))
    except FileNotFoundError:
        observations = None
        if kind_of(folder):
            found.append(Finding(folder / SETTINGS, "it is missing"))
    return Notes(
        names=names,
        attempts={attempt.id: attempt for attempt in attempts},
        sources=sources,
        observations=observations,
        findings=found,
    )


def verify_folder(dataset: DemonstrationDataset, notes: Notes, task: Task | None = None) -> list[Finding]:
    """Check the ledger against the task and the recordings, and that no other files lie among these.

    A line missing from the ledger is noticed where a recording remains; a failure without a recording leaves no trace.

    Args:
        dataset: The folder.
        notes: What `read_notes` found in the folder.
        task: The task of the dataset; without it, conditions are not checked.
    """
    ledger, names, noted = dataset.ledger.path, set(notes.names), notes.attempts.values()
    found = list(notes.findings)
    for attempt in noted:
        if attempt.condition.task != dataset.task:
            found.append(Finding(ledger, f"attempt {attempt.id} is one at task {attempt.condition.task!r}"))
        elif task is not None and (problem := wrong_condition(task, attempt.condition)):
            found.append(Finding(ledger, f"attempt {attempt.id}: {problem}"))
        if (attempt.success or attempt.recorded) and attempt.id not in names:
            found.append(Finding(dataset.file_of(attempt.id), "the recording of this attempt is missing"))
    for name in sorted(names - set(notes.attempts)):
        problem = f"there is no line for {name}: it was removed, or a kill came before it (`collect` adds it)"
        found.append(Finding(ledger, problem))
    if notes.sources == {} and (names or noted):
        found.append(Finding(dataset.path / SOURCES, "it is missing, so nothing says what made the attempts"))
    found += [Finding(path, f"it is {kind_of(path)}") for path in files_in(dataset.path) if _odd(path)]
    return found + _strangers(dataset.path / EPISODES, names) + _strangers(dataset.path / OBSERVATIONS, names, SETTINGS)


def wrong_condition(task: Task, condition: Condition) -> str:
    """Return why a condition is not one of a task; "" where it is."""
    try:
        task.conditions.validate(condition)
    except ValueError as error:
        return str(error)
    return ""


def _odd(path: Path) -> bool:
    """Return whether something is neither file nor folder, apart from names that are checked elsewhere."""
    return kind_of(path) not in ("a file", "a folder") and path.name not in (EPISODES, OBSERVATIONS, *NOTES)


def _strangers(folder: Path, names: set[str], *others: str) -> list[Finding]:
    """Return files that do not belong to a folder; a temporary file, still being written, does."""
    try:
        paths = files_in(folder)
    except DamagedFileError:  # reported for the folder itself
        return []
    return [
        Finding(path, "it belongs to no episode here")
        for path in paths
        if not (path.suffix == SUFFIX and path.stem in names) and path.name not in others and not is_temporary(path)
    ]
