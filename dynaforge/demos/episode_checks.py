"""The checks of a single recording; each yields the problems that it finds, as sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from dynaforge.demos.consistency import contradictions, is_planned
from dynaforge.demos.dataset import SOURCES
from dynaforge.demos.differences import differences
from dynaforge.demos.episode import Attempt, Episode
from dynaforge.demos.folder_checks import wrong_condition
from dynaforge.demos.provenance import Provenance
from dynaforge.demos.replay import Replayer
from dynaforge.demos.schema import state_digests
from dynaforge.planning import ArmKinematics
from dynaforge.sim import franka
from dynaforge.tasks import Task
from dynaforge.tasks.digest import task_digest

Check = Callable[[Episode], Iterable[str]]


def digests(episode: Episode) -> Iterator[str]:
    """Compare the states with the digests that were stored with them."""
    noted, found = episode.meta.get("state_digests"), state_digests(episode.steps)
    if noted is not None and list(noted) != found:
        second = next((k for k, (a, b) in enumerate(zip(noted, found, strict=False)) if a != b), len(found))
        yield f"its states differ from their digest at second {second}"


def rewards(episode: Episode) -> Iterator[str]:
    """Check that only the last step is rewarded, and with 1 exactly on success."""
    reward = episode.steps.get("reward")
    if reward is not None and len(reward):
        if reward[:-1].any():
            yield "it has a reward before its last step"
        if (reward[-1] == 1.0) != episode.success:
            yield f"its last reward is {reward[-1]:g}, its success {episode.success}"


def numbers(episode: Episode) -> Iterator[str]:
    """Check that there is neither NaN nor infinity."""
    for name, array in episode.steps.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            step = int(np.argwhere(~np.isfinite(array))[0][0])
            yield f"{name} is not finite at step {step}"


def of_source(sources: Mapping[str, Provenance] | None) -> Check:
    """Return a check against the folder's notes on generators; that they are missing is reported elsewhere."""

    def check(episode: Episode) -> Iterator[str]:
        if not sources:
            return
        source = sources.get(episode.generator)
        if source is None:
            yield f"{SOURCES} does not know its generator {episode.generator!r}"
            return
        for name, noted in (("policy_hash", source.policy), ("task_hash", source.task_definition)):
            if episode.meta.get(name, "") != noted:
                yield f"its {name} is {episode.meta.get(name, '')!r}, {SOURCES} notes {noted!r}"

    return check


def of_ledger(attempts: Mapping[str, Attempt]) -> Check:
    """Return a check against the line of the ledger with the same id."""

    def check(episode: Episode) -> Iterator[str]:
        if (noted := attempts.get(episode.id)) is None:
            return
        line, found = noted.facts(), episode.facts()
        for name in line | found:
            if line.get(name) != found.get(name):
                yield f"the ledger notes {name} {line.get(name)!r}, the file {found.get(name)!r}"

    return check


def of_task(task: Task) -> Check:
    """Return a check against the task's definition, and of the columns against each other as the task relates them."""
    kinematics, definition = ArmKinematics(franka()), task_digest(task)

    def check(episode: Episode) -> Iterator[str]:
        if episode.meta.get("task_hash", definition) != definition:
            yield f"it was recorded with another definition of task {task.name!r}"
        if problem := wrong_condition(task, episode.condition):
            yield problem
        yield from contradictions(episode, task, kinematics)

    return check


def of_physics(again: Callable[[Episode], Episode] | None, replayer: Replayer | None) -> Check:
    """Return a check that makes the attempt again and compares the recordings, or else replays its joint references.

    Args:
        again: Makes an attempt again from its recording; None to skip that.
        replayer: Replays an episode that `again` cannot repeat; None to skip that.
    """

    def check(episode: Episode) -> Iterator[str]:
        if again is not None and is_planned(episode):
            try:
                found = differences(episode, again(episode))
            except ValueError as error:
                found = [str(error)]
            yield from (f"{problem}{_versions(episode)}" for problem in found)
            if not found:
                return  # an attempt repeated bit for bit has repeated its physics too
        if replayer is None:
            return
        replay = replayer.replay(episode)
        if replay.divergence is not None:
            yield f"its replay leaves the recording: {replay.divergence}{_versions(episode)}"
        elif replay.success != episode.success:
            yield f"its success is recorded as {episode.success}, its replay ends in {replay.success}"
        elif episode.loads not in (None, replay.loads):
            yield f"its loads are recorded as {episode.loads}, its replay gives {replay.loads}"

    return check


def _versions(episode: Episode) -> str:
    changed = []
    for package, recorded in dict(episode.meta.get("versions", {})).items():
        try:
            here = version(package)
        except (PackageNotFoundError, ValueError):
            here = "missing"
        if here != recorded:
            changed.append(f"{package} {recorded}, here {here}")
    return f" (recorded with {'; '.join(changed)})" if changed else ""
