"""What can be wrong with a folder of demonstrations, found and named file by file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.audit import audit
from dynaforge.demos.consistency import contradictions, is_planned
from dynaforge.demos.dataset import EPISODES, NOTES, SOURCES, DemonstrationDataset, Provenance
from dynaforge.demos.differences import differences, first_row
from dynaforge.demos.episode import Episode
from dynaforge.demos.episode_file import SUFFIX
from dynaforge.demos.ledger import Attempt
from dynaforge.demos.observation_file import SETTINGS
from dynaforge.demos.observations import FOLDER as OBSERVATIONS
from dynaforge.demos.observations import ObservationFolder
from dynaforge.demos.replay import Replayer
from dynaforge.demos.schema import state_digests
from dynaforge.demos.untrusted import MALFORMED, DamagedFileError, files_in, kind_of, printable
from dynaforge.files.atomic import is_temporary
from dynaforge.planning import ArmKinematics
from dynaforge.sim import Condition, franka
from dynaforge.tasks import Task
from dynaforge.tasks.digest import task_digest

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is wrong.

    Attributes:
        path: The file.
        problem: What is wrong with it.
    """

    path: Path
    problem: str

    def __str__(self) -> str:
        return printable(f"{self.path}: {self.problem}")


@dataclass(frozen=True, slots=True)
class Notes:
    """What a folder notes beside its recordings, read once.

    Attributes:
        names: Ids of the recordings.
        attempts: The ledger, by id.
        sources: `generators.json`; None where it cannot be read.
        observations: The rendered observations; None where there are none, or their settings cannot be read.
        findings: What was wrong with all this.
    """

    names: list[str] = field(default_factory=list)
    attempts: Mapping[str, Attempt] = field(default_factory=dict)
    sources: Mapping[str, Provenance] | None = None
    observations: ObservationFolder | None = None
    findings: list[Finding] = field(default_factory=list)


def read_notes(dataset: DemonstrationDataset) -> Notes:
    """Read what there is beside the recordings, each file once; what cannot be read is a finding."""
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
    return Notes(names, {attempt.id: attempt for attempt in attempts}, sources, observations, found)


def verify_folder(dataset: DemonstrationDataset, notes: Notes, task: Task | None = None) -> list[Finding]:
    """Check the ledger against the task and the recordings, both ways, and that nothing else lies among the files.

    Lines lost from the ledger are seen by the recordings they spoke of; of a lost failure that left none, nothing is.
    """
    ledger, names, noted = dataset.ledger.path, set(notes.names), notes.attempts.values()
    found = list(notes.findings)
    for attempt in noted:
        if attempt.condition.task != dataset.task:
            found.append(Finding(ledger, f"attempt {attempt.id} is one at task {attempt.condition.task!r}"))
        elif task is not None and (problem := _wrong_condition(task, attempt.condition)):
            found.append(Finding(ledger, f"attempt {attempt.id}: {problem}"))
        if (attempt.success or attempt.recorded) and attempt.id not in names:
            found.append(Finding(dataset.file_of(attempt.id), "the recording of this attempt is missing"))
    for name in sorted(names - set(notes.attempts)):
        found.append(Finding(ledger, f"no line tells of {name}: lost, or a kill fell before it (`collect` adds it)"))
    if notes.sources == {} and (names or noted):
        found.append(Finding(dataset.path / SOURCES, "it is missing, so nothing says what made the attempts"))
    found += [Finding(path, f"it is {kind_of(path)}") for path in files_in(dataset.path) if _odd(path)]
    return found + _strangers(dataset.path / EPISODES, names) + _strangers(dataset.path / OBSERVATIONS, names, SETTINGS)


def _wrong_condition(task: Task, condition: Condition) -> str:
    try:
        task.conditions.validate(condition)
    except ValueError as error:
        return str(error)
    return ""


def _odd(path: Path) -> bool:
    """Tell whether something is neither file nor folder, and is not looked at by its name anyway."""
    return kind_of(path) not in ("a file", "a folder") and path.name not in (EPISODES, OBSERVATIONS, *NOTES)


def _strangers(folder: Path, names: set[str], *others: str) -> list[Finding]:
    """Find files that are none of a folder's; a file under way is one."""
    try:
        paths = files_in(folder)
    except DamagedFileError:  # said of the folder
        return []
    return [
        Finding(path, "it belongs to no episode here")
        for path in paths
        if not (path.suffix == SUFFIX and path.stem in names) and path.name not in others and not is_temporary(path)
    ]


class EpisodeVerifier:
    """Checks one recording after the other, what was rendered of it, and its physics if that is asked for.

    Args:
        dataset: Where they are.
        notes: What lies beside them.
        task: Of which they are; without it their columns are not compared with each other.
        again: Makes an attempt again from its recording, as `dynaforge.generators.repeat.Repeater` does.
        replayer: Simulates what an attempt made again does not repeat, and looks for deep overlaps.
        audited: Look for motion that is not possible, too.
        render: Renders an episode again, as `ObservationRenderer.render` does with the settings of the folder.
    """

    def __init__(
        self, dataset: DemonstrationDataset, notes: Notes, *, task: Task | None = None,
        again: Callable[[Episode], Episode] | None = None, replayer: Replayer | None = None, audited: bool = False,
        render: Callable[[Episode], Mapping[str, NDArray[Any]]] | None = None,
    ) -> None:  # fmt: skip
        self._dataset, self._notes, self._task = dataset, notes, task
        self._again, self._replayer, self._audited, self._render = again, replayer, audited, render
        self._kinematics = ArmKinematics(franka()) if task is not None else None

    def __call__(self, name: str) -> list[Finding]:
        """Check a recording by its id; whatever is wrong with it is a finding, and never an exception."""
        path = self._dataset.file_of(name)
        try:
            episode = self._dataset[name]
        except DamagedFileError as error:
            return [Finding(path, error.reason)]
        except KeyError:
            return [Finding(path, "it was there when the folder was listed, and is gone")]
        with np.errstate(all="ignore"):  # what a forger writes may overflow
            problems = [problem for check in self._checks(episode) for problem in _outcome_of(check, episode)]
        return [Finding(path, problem) for problem in problems] + self._wrong_observations(episode)

    def _checks(self, episode: Episode) -> Iterator[Callable[[Episode], Iterable[str]]]:
        yield _wrong_digests
        yield self._wrong_source
        yield self._wrong_outcome
        if problems := list(_wrong_values(episode)):
            yield lambda _: problems
            return  # nothing below means anything where numbers are missing
        yield self._wrong_columns
        yield self._wrong_physics
        if self._audited:
            yield lambda episode: map(str, audit(episode, replayer=self._replayer))

    def _wrong_columns(self, episode: Episode) -> Iterator[str]:
        if self._task is None or self._kinematics is None:
            return
        if episode.meta.get("task_hash", task_digest(self._task)) != task_digest(self._task):
            yield f"it was recorded with another definition of task {self._dataset.task!r}"
        if problem := _wrong_condition(self._task, episode.condition):
            yield problem
        yield from contradictions(episode, self._task, self._kinematics)

    def _wrong_physics(self, episode: Episode) -> Iterator[str]:
        if self._again is not None and is_planned(episode):
            try:
                found = differences(episode, self._again(episode))
            except ValueError as error:
                found = [str(error)]
            yield from (f"{problem}{_versions(episode)}" for problem in found)
            if not found:
                return  # an attempt that repeats to the bit has repeated its physics
        if self._replayer is None:
            return
        replay = self._replayer.replay(episode)
        if replay.divergence is not None:
            yield f"its replay leaves the recording: {replay.divergence}{_versions(episode)}"
        elif replay.success != episode.success:
            yield f"its success is recorded as {episode.success}, its replay ends in {replay.success}"

    def _wrong_source(self, episode: Episode) -> Iterator[str]:
        sources = self._notes.sources
        if not sources:  # said of the folder
            return
        source = sources.get(episode.generator)
        if source is None:
            yield f"{SOURCES} does not know its generator {episode.generator!r}"
            return
        for name, noted in (("policy_hash", source.policy), ("task_hash", source.task_definition)):
            if episode.meta.get(name, "") != noted:
                yield f"its {name} is {episode.meta.get(name, '')!r}, {SOURCES} notes {noted!r}"

    def _wrong_outcome(self, episode: Episode) -> Iterator[str]:
        rewards = episode.steps.get("reward")
        if rewards is not None and len(rewards):
            if rewards[:-1].any():
                yield "it has a reward before its last step"
            if (rewards[-1] == 1.0) != episode.success:
                yield f"its last reward is {rewards[-1]:g}, its success {episode.success}"
        if (noted := self._notes.attempts.get(episode.id)) is not None:
            found = Attempt.of(episode).to_dict()
            for name, value in noted.to_dict().items():
                if name not in ("wall_seconds", "block", "recorded") and value != found[name]:
                    yield f"the ledger notes {name} {value!r}, the file {found[name]!r}"

    def _wrong_observations(self, episode: Episode) -> list[Finding]:
        if (observations := self._notes.observations) is None:
            return []
        path = observations.file_of(episode.id)
        try:
            arrays = observations.of(episode)
            again = self._render(episode) if self._render is not None else arrays
        except FileNotFoundError:
            return []
        except DamagedFileError as error:
            return [Finding(error.path, error.reason)]
        except MALFORMED as error:
            return [Finding(path, f"it cannot be rendered again: {printable(error)}")]
        first = {name: first_row(array, again[name]) for name, array in arrays.items()}
        return [
            Finding(path, f"{name} is not what rendering gives from step {step} on")
            for name, step in first.items()
            if step is not None
        ]


def verify(
    dataset: DemonstrationDataset, *, task: Task | None = None, again: Callable[[Episode], Episode] | None = None,
    replayer: Replayer | None = None, audited: bool = False,
) -> Iterator[list[Finding]]:  # fmt: skip
    """Check everything: yields the findings of the folder as a whole, then of each recording in turn.

    Args:
        dataset, task, again, replayer, audited: As `EpisodeVerifier`.
    """
    notes = read_notes(dataset)
    yield verify_folder(dataset, notes, task)
    yield from map(
        EpisodeVerifier(dataset, notes, task=task, again=again, replayer=replayer, audited=audited), notes.names
    )


def _outcome_of(check: Callable[[Episode], Iterable[str]], episode: Episode) -> list[str]:
    """Run a check to its end, or to where something in the recording stops it, which is a problem itself."""
    problems: list[str] = []
    try:
        problems.extend(check(episode))
    except MALFORMED as error:
        problems.append(f"it cannot be checked to the end: {printable(error) or type(error).__name__}")
    return problems


def _wrong_values(episode: Episode) -> Iterator[str]:
    for name, array in episode.steps.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            step = int(np.argwhere(~np.isfinite(array))[0][0])
            yield f"{name} is not finite at step {step}"


def _wrong_digests(episode: Episode) -> Iterator[str]:
    noted, found = episode.meta.get("state_digests"), state_digests(episode.steps)
    if noted is not None and list(noted) != found:
        second = next((k for k, (a, b) in enumerate(zip(noted, found, strict=False)) if a != b), len(found))
        yield f"its states differ from their digest at second {second}"


def _versions(episode: Episode) -> str:
    from importlib.metadata import PackageNotFoundError, version

    changed = []
    for package, recorded in dict(episode.meta.get("versions", {})).items():
        try:
            here = version(package)
        except (PackageNotFoundError, ValueError):
            here = "missing"
        if here != recorded:
            changed.append(f"{package} {recorded}, here {here}")
    return f" (recorded with {'; '.join(changed)})" if changed else ""
