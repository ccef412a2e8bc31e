"""The runs of a comparison: every variant on every task with every training seed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym

from dynaforge.registration import env_id
from dynaforge.tasks import Task, task_source
from dynaforge.training.run_spec import PLANNER_ONLY, Evaluation, RunSpec
from dynaforge.training.settings import variants
from dynaforge.training.varied import parsed_value

Variants = dict[str, tuple[str, dict[str, Any]]]
"""Name of a variant to its file of zoo_configs and its changes."""


def run_matrix(
    tasks: Sequence[Task], compared: Variants, *, seeds: int, steps: int, evaluation: Evaluation, out: Path
) -> list[RunSpec]:
    """List the runs: first the planner's, then all of seed 0, of seed 1 and so on.

    In this order the runs that are finished at any moment can be compared.

    Args:
        tasks: The tasks.
        compared: Variants to compare.
        seeds: Number of training seeds of every variant.
        steps: Environment steps of a run.
        evaluation: Conditions on which the final policies are evaluated.
        out: Folder of the comparison.
    """
    planner = [
        RunSpec(
            task=task_source(task),
            setting=task.setting,
            variant=PLANNER_ONLY,
            algo="",
            changes={},
            seed=0,
            steps=0,
            evaluation=evaluation,
            folder=out / task.name / PLANNER_ONLY,
        )
        for task in tasks
    ]
    trained = [
        RunSpec(
            task=task_source(task),
            setting=task.setting,
            variant=variant,
            algo=algo,
            changes=changes,
            seed=seed,
            steps=steps,
            evaluation=evaluation,
            folder=out / task.name / variant / f"seed-{seed}",
        )
        for seed in range(seeds)
        for task in tasks
        for variant, (algo, changes) in compared.items()
    ]
    return planner + trained


def compared_variants(names: Sequence[str], vary: Sequence[str] | None = None) -> Variants:
    """Return variants of zoo_configs/compare.yml by name.

    Args:
        names: Their names.
        vary: A setting, then the values that replace its own; each value makes a variant of every name.
    """
    known = variants()
    compared: Variants = {}
    for name in names:
        settings = dict(known[name])
        algo = settings.pop("config")
        compared |= {variant: (algo, changes) for variant, changes in _varied(name, settings, vary)}
    return compared


def check_variants(compared: Variants, task: str) -> None:
    """Build the model of every variant once, on a single env, so that a wrong setting is refused before any training.

    Args:
        compared: The variants.
        task: Name of a task to build them for.

    Raises:
        ValueError: The algorithm does not know a setting, or refuses it.
    """
    for algo, changes in compared.values():
        _check_settings(algo, changes, task)


def refuse_links(folder: Path, out: Path) -> None:
    """Refuse to write through links: a folder that came from somebody else may lead anywhere.

    Args:
        folder: The folder of a run.
        out: The folder of the comparison, above it.

    Raises:
        ValueError: There is a link between the two; the message names it.
    """
    below = folder.relative_to(out).parts
    for depth in range(1, len(below) + 1):
        path = out.joinpath(*below[:depth])
        if path.is_symlink():
            raise ValueError(
                f"{path} is a link, and runs are not written through one. Remove it, or choose another --out."
            )


def _varied(name: str, settings: dict[str, Any], vary: Sequence[str] | None) -> list[tuple[str, dict[str, Any]]]:
    if not vary:
        return [(name, settings)]
    setting, *values = vary
    return [(f"{name}+{setting}={value}", settings | {setting: parsed_value(value)}) for value in values]


def _check_settings(algo: str, changes: Mapping[str, Any], task: str) -> None:
    from dynaforge.training.model import build_model

    env = gym.make(env_id(task))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # PPO's batch does not suit a single env
            build_model(task, env, algo=algo, **changes)
    except (TypeError, AssertionError) as error:  # SB3 asserts that a schedule is one
        raise ValueError(f"{algo} with {changes}: {str(error).rstrip('.')}.") from error
    finally:
        env.close()
