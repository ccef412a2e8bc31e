"""What can be wrong with a folder of demonstrations, found and named file by file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaforge.demos.atomic import is_temporary
from dynaforge.demos.audit import audit
from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.episode import Episode
from dynaforge.demos.episode_file import SUFFIX, DamagedFileError
from dynaforge.demos.ledger import Attempt
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


def verify_ledger(dataset: DemonstrationDataset) -> list[Finding]:
    """Check the ledger, and that every success in it has its recording."""
    path = dataset.ledger.path
    found = [Finding(path, f"line {n} was torn or altered") for n in dataset.ledger.damaged_lines()]
    names = set(dataset.ids())
    for attempt in dataset.ledger.attempts():
        if attempt.condition.task != dataset.task:
            found.append(Finding(path, f"attempt {attempt.id} is one at task {attempt.condition.task!r}"))
        elif attempt.success and attempt.id not in names:
            found.append(Finding(dataset.file_of(attempt.id), "the recording of this success is missing"))
    for other in sorted((dataset.path / "episodes").iterdir()):
        if other.suffix != SUFFIX and not is_temporary(other):
            found.append(Finding(other, "it is no episode file"))
    return found


def verify_episode(
    dataset: DemonstrationDataset, name: str, noted: Attempt | None, replayer: Replayer | None = None, *,
    audited: bool = False,
) -> list[Finding]:  # fmt: skip
    """Check one recording: bytes, shapes, time, finite values, outcome; and its physics, if a replayer is given.

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
    problems = [*_wrong_values(episode), *_wrong_digests(episode), *_wrong_outcome(episode, noted)]
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
    return [Finding(path, problem) for problem in problems]


def verify(
    dataset: DemonstrationDataset, *, replayer: Replayer | None = None, audited: bool = False
) -> Iterator[list[Finding]]:
    """Check everything: yields the findings of the ledger, then of each recording in turn."""
    yield verify_ledger(dataset)
    noted = {attempt.id: attempt for attempt in dataset.ledger.attempts()}
    for name in dataset.ids():
        yield verify_episode(dataset, name, noted.get(name), replayer, audited=audited)


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
    if noted is not None and (noted.success, noted.failure) != (episode.success, episode.failure):
        yield f"the ledger notes {noted.failure or 'success'!r}, the file {episode.failure or 'success'!r}"


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
