"""The task of a folder of demonstrations.

A folder may come from anybody, so nothing that it names is imported. A user-defined task must be given by the user, and
is accepted only if the demonstrations were made with it.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable
from dataclasses import replace

from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.provenance import Provenance, settings_of
from dynaforge.demos.untrusted import DamagedFileError
from dynaforge.registration import ENV_NAMES
from dynaforge.tasks import FRAMES, Task, get_task, task_file_name
from dynaforge.tasks.digest import task_digest


def task_of(dataset: DemonstrationDataset, given: str | None) -> Task:
    """Return the task of a dataset, in the setting that its attempts were made under.

    Args:
        dataset: The demonstrations.
        given: Name, env id or file of the task, as the user gave it; None for a task of the package.

    Raises:
        ValueError: The task is user-defined and was not given, or another one was given.
    """
    if given is None and dataset.task not in ENV_NAMES:
        raise ValueError(f"{dataset.path}: {_origin(dataset)}")
    task = get_task(given or dataset.task)
    if task.name != dataset.task:
        raise ValueError(
            f"{dataset.path} holds demonstrations of task {dataset.task!r}; {given} is task {task.name!r}."
        )
    sources = _sources(dataset)
    recorded, (task, *others) = {source.task_definition for source in sources}, _settings(task, sources)
    leads = dict.fromkeys((0.0, *(source.lead_time for source in sources)))
    variants = (variant for each in (task, *others) for lead in leads for variant in _variants(each, lead))
    variant = next((same for same in variants if task_digest(same) in recorded), None)
    if variant is None and recorded and (file := task_file_name(task)):
        raise ValueError(
            f"{dataset.path}: the scene, conditions, phases or residual of {file} differ from those that the "
            f"demonstrations were made with, since its digest is {task_digest(task)}. {_origin(dataset)}"
        )
    return variant or task


def _settings(task: Task, sources: list[Provenance]) -> list[Task]:
    """Return a task in every setting that is noted and that it can have; as it is where there is none."""
    found = []
    for setting in settings_of(sources):
        with contextlib.suppress(ValueError):  # a folder from elsewhere may note one that this task cannot have
            found.append(task.under(**setting.to_dict()))
    return found or [task]


def _variants(task: Task, lead_time: float) -> Iterable[Task]:
    """Yield the task with a lead time if there is one, then as `forge --residual-frame` changes it."""
    task = replace(task, lead_time=lead_time) if lead_time else task
    yield task
    for frame in FRAMES:
        yield replace(task, residual=replace(task.residual, frame=frame))


def _sources(dataset: DemonstrationDataset) -> list[Provenance]:
    try:
        return list(dataset.sources().values())
    except DamagedFileError:  # `verify` reports it
        return []


def _origin(dataset: DemonstrationDataset) -> str:
    """Describe which task the demonstrations were made with, and how to give it."""
    sources = _sources(dataset)
    found = {source.task_definition for source in sources if re.fullmatch("[0-9a-f]{16}", source.task_definition)}
    digests = " and ".join(sorted(found)) or "unknown"
    names = sorted({source.task_file for source in sources if re.fullmatch(r"[\w-]+\.py", source.task_file)})
    made_with = f"made with {names[0]}" if names else "made with a task file"
    return (
        f"This dataset was {made_with} (task {dataset.task!r}, digest {digests}); give it with "
        f"--task-file {names[0] if names else 'FILE'}."
    )
