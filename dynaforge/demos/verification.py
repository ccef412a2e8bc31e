"""What can be wrong with a folder of demonstrations, found and named file by file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaforge.demos.atomic import is_temporary
from dynaforge.demos.audit import audit
from dynaforge.demos.dataset import SOURCES, DemonstrationDataset
from dynaforge.demos.episode import Episode
from dynaforge.demos.episode_file import SUFFIX, DamagedFileError
from dynaforge.demos.ledger import Attempt
from dynaforge.demos.observations import FOLDER as OBSERVATIONS
from dynaforge.demos.observations import SETTINGS, ObservationFolder
from dynaforge.demos.replay import Replayer
from dynaforge.demos.schema import state_digests
from dynaforge.tasks.digest import task_digest


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
        return f"{self.path}: {self.problem}"


def verify_folder(dataset: DemonstrationDataset) -> list[Finding]:
    """Check the ledger against the recordings, both ways, and that nothing else lies among the files.

    Lines lost from the ledger are seen by the recordings they spoke of; of a lost failure that left none, nothing is.
    """
    ledger, names = dataset.ledger.path, set(dataset.ids())
    found = [Finding(ledger, f"line {n} was torn or altered") for n in dataset.ledger.damaged_lines()]
    noted = dataset.ledger.attempts()
    for attempt in noted:
        if attempt.condition.task != dataset.task:
            found.append(Finding(ledger, f"attempt {attempt.id} is one at task {attempt.condition.task!r}"))
    for attempt in dataset.lost():
        found.append(Finding(dataset.file_of(attempt.id), "the recording of this attempt is missing"))
    for name in sorted(names - {attempt.id for attempt in noted}):
        found.append(Finding(ledger, f"no line tells of {name}: lost, or a kill fell before it (`collect` adds it)"))
    try:
        dataset.sources()
    except DamagedFileError as error:
        found.append(Finding(error.path, error.reason))
    return found + _strangers(dataset.path / "episodes", names) + _observation_findings(dataset, names)


def _strangers(folder: Path, names: set[str], *others: str) -> list[Finding]:
    """Find files that are none of a folder's; a file under way is one."""
    return [
        Finding(path, "it belongs to no episode here")
        for path in (sorted(folder.iterdir()) if folder.is_dir() else [])
        if not (path.suffix == SUFFIX and path.stem in names) and path.name not in others and not is_temporary(path)
    ]


def _observation_findings(dataset: DemonstrationDataset, names: set[str]) -> list[Finding]:
    folder = dataset.path / OBSERVATIONS
    found = _strangers(folder, names, SETTINGS)
    if folder.is_dir():
        try:
            ObservationFolder(folder)
        except FileNotFoundError:
            found.append(Finding(folder / SETTINGS, "it is missing"))
        except DamagedFileError as error:
            found.append(Finding(error.path, error.reason))
    return found


def verify_episode(
    dataset: DemonstrationDataset, name: str, noted: Attempt | None, replayer: Replayer | None = None, *,
    audited: bool = False,
) -> list[Finding]:  # fmt: skip
    """Check one recording, what was rendered of it, and its physics if a replayer is given.

    Args:
        dataset: Where it is.
        name: Its id.
        noted: Its line in the ledger; None where a kill fell between the two.
        replayer: Simulates it again.
        audited: Look for motion that is not possible, too.
    """
    path = dataset.file_of(name)
    try:
        episode = dataset[name]
    except DamagedFileError as error:
        return [Finding(path, error.reason)]
    problems = [
        *_wrong_values(episode),
        *_wrong_digests(episode),
        *_wrong_source(dataset, episode),
        *_wrong_outcome(episode, noted),
    ]
    if replayer is not None:
        if episode.meta.get("task_hash", task_digest(replayer.task)) != task_digest(replayer.task):
            problems.append(f"it was recorded with another definition of task {dataset.task!r}")
        try:
            replay = replayer.replay(episode)
        except ValueError as error:
            problems.append(str(error))
        else:
            if replay.divergence is not None:
                problems.append(f"its replay leaves the recording: {replay.divergence}{_versions(episode)}")
            elif replay.success != episode.success:
                problems.append(f"its success is recorded as {episode.success}, its replay ends in {replay.success}")
    if audited:
        problems += map(str, audit(episode, replayer=replayer))
    return [Finding(path, problem) for problem in problems] + _wrong_observations(dataset, episode)


def verify(
    dataset: DemonstrationDataset, *, replayer: Replayer | None = None, audited: bool = False
) -> Iterator[list[Finding]]:
    """Check everything: yields the findings of the folder as a whole, then of each recording in turn."""
    yield verify_folder(dataset)
    noted = {attempt.id: attempt for attempt in dataset.ledger.attempts()}
    for name in dataset.ids():
        yield verify_episode(dataset, name, noted.get(name), replayer, audited=audited)


def _wrong_observations(dataset: DemonstrationDataset, episode: Episode) -> list[Finding]:
    try:
        ObservationFolder(dataset.path / OBSERVATIONS).of(episode)
    except FileNotFoundError:
        return []
    except DamagedFileError as error:
        return [Finding(error.path, error.reason)]
    return []


def _wrong_source(dataset: DemonstrationDataset, episode: Episode) -> Iterator[str]:
    try:
        sources = dataset.sources()
    except DamagedFileError:  # said of the folder
        return
    source = sources.get(episode.generator)
    if source is None:
        if sources:
            yield f"{SOURCES} does not know its generator {episode.generator!r}"
        return
    for name, noted in (("policy_hash", source.policy), ("task_hash", source.task_definition)):
        if episode.meta.get(name, "") != noted:
            yield f"its {name} is {episode.meta.get(name, '')!r}, {SOURCES} notes {noted!r}"


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


def _wrong_outcome(episode: Episode, noted: Attempt | None) -> Iterator[str]:
    rewards = episode.steps.get("reward")
    if rewards is not None and len(rewards):
        if rewards[:-1].any():
            yield "it has a reward before its last step"
        if (rewards[-1] == 1.0) != episode.success:
            yield f"its last reward is {rewards[-1]:g}, its success {episode.success}"
    if noted is not None:
        found = Attempt.of(episode).to_dict()
        for name, value in noted.to_dict().items():
            if name not in ("wall_seconds", "block", "recorded") and value != found[name]:
                yield f"the ledger notes {name} {value!r}, the file {found[name]!r}"


def _versions(episode: Episode) -> str:
    from importlib.metadata import PackageNotFoundError, version

    changed = []
    for package, recorded in dict(episode.meta.get("versions", {})).items():
        try:
            here = version(package)
        except PackageNotFoundError:
            here = "missing"
        if here != recorded:
            changed.append(f"{package} {recorded}, here {here}")
    return f" (recorded with {'; '.join(changed)})" if changed else ""
