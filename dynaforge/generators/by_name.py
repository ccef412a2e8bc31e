"""Generators by the names that commands use, and the policies that they run."""

from __future__ import annotations

from pathlib import Path

from dynaforge.algos.policy_file import POLICY_FILE, MlpPolicyFile
from dynaforge.generators.generator import ExploringPolicy, Generator, PlannerOnly, ResidualGenerator
from dynaforge.generators.learner import LearnerGenerator
from dynaforge.generators.names import GENERATORS
from dynaforge.generators.oracle import Oracle
from dynaforge.sim.setting import Setting
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import Task, task_file_name
from dynaforge.tasks.digest import task_digest


def make_generator(
    name: str,
    task: Task,
    *,
    policy: Path | None = None,
    sigma: float = 0.25,
    oracle_tries: int = 64,
    learner: str | None = None,
    observations: Path | None = None,
) -> Generator:
    """Return a new generator.

    Args:
        name: One of `GENERATORS`.
        task: What it attempts.
        policy: Policy file for "residual" and "exploring"; None takes the one that is shipped for the task.
        sigma: Standard deviation of the noise for "exploring", in units of the residual action.
        oracle_tries: Residuals that "oracle" tries on each condition.
        learner: Where the policy of "learner" comes from: "module:function" or "file.py:function".
        observations: Folder of `dynaforge render` whose settings the observations of "learner" are made with.

    Raises:
        ValueError: The name is unknown, or the policy file does not fit the task, or none is shipped.
    """
    match name:
        case "planner_only":
            return PlannerOnly()
        case "residual":
            trained = policy_for(task, policy)
            return ResidualGenerator(trained, policy_hash=trained.digest)
        case "exploring":
            trained = policy_for(task, policy)
            return ResidualGenerator(ExploringPolicy(trained, sigma), policy_hash=trained.digest, name=name)
        case "oracle":
            return Oracle(m=oracle_tries)
        case "learner" if learner is not None:
            return _make_learner(learner, observations)
    raise ValueError(f"No generator {name!r}; known are {', '.join(GENERATORS)}.")


def policy_for(task: Task, path: str | Path | None = None) -> MlpPolicyFile:
    """Read a policy and check that it was trained for a task, as it is now and in its setting.

    Args:
        task: The task.
        path: The policy file; None takes the one that is shipped for the task.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: None is shipped, or the file is damaged, of another task or of other sizes than the task's env, or
            was trained for another definition or under another setting of the task.
    """
    policy = MlpPolicyFile.load(shipped_policy(task) if path is None else path, task=task)
    if policy.meta.get("task_definition") != task_digest(task):
        which = f"The shipped policy of {task.name!r}" if path is None else f"{path}"
        raise ValueError(f"{which} was trained {_trained_for(policy, task)}, so it is not used. {_remedy(task)}")
    return policy


def _trained_for(policy: MlpPolicyFile, task: Task) -> str:
    """Say for what other task than this one a policy was trained."""
    if "setting" not in policy.meta:
        return "for another definition of the task (rigid arm, no force reflex)"
    try:
        setting = Setting.from_dict(policy.meta["setting"])
    except ValueError:
        return "for another definition of the task (its setting is unreadable)"
    if setting == task.setting:
        return "for another definition of the task (other scene, conditions, phases or residual)"
    return f"under another setting ({setting}) than this one ({task.setting})"


def _remedy(task: Task) -> str:
    file = task_file_name(task) or task.name
    return f"Use --generator planner_only, or train one: dynaforge forge --task {file}."


def shipped_policy(task: Task) -> Path:
    """Return the policy file that is shipped for a task.

    Raises:
        ValueError: There is none.
    """
    try:
        return asset_path(f"{task.name}/{POLICY_FILE}")
    except FileNotFoundError:
        raise ValueError(
            f"No policy is shipped for task {task.name!r}: pass --policy FILE, which `dynaforge forge` makes."
        ) from None


def _make_learner(learner: str, observations: Path | None) -> Generator:
    from dynaforge.demos.observations import ObservationFolder

    settings = ObservationFolder(observations).settings if observations else None
    return LearnerGenerator(learner, settings=settings)
