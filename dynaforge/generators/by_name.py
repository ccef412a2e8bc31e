"""Generators by the names that commands use, and the policies that they run."""

from __future__ import annotations

from pathlib import Path

from dynaforge.algos.policy_file import POLICY_FILE, MlpPolicyFile
from dynaforge.generators.generator import ExploringPolicy, Generator, PlannerOnly, ResidualGenerator
from dynaforge.generators.learner import LearnerGenerator
from dynaforge.generators.names import GENERATORS
from dynaforge.generators.oracle import Oracle
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import Task
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
    """Read a policy and check that it fits a task.

    Args:
        task: The task.
        path: The policy file; None takes the one that is shipped for the task.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: None is shipped, or the file is damaged, of another task, of other sizes than the task's env, or
            trained for another definition or setting of the task.
    """
    policy = MlpPolicyFile.load(shipped_policy(task) if path is None else path, task=task)
    if policy.meta.get("task_definition") == task_digest(task):
        return policy
    which = f"The policy shipped for task {task.name!r}" if path is None else f"{path}"
    trained = policy.meta.get("setting")
    if trained is not None and trained != str(task.setting):
        difference = f"in another setting ({trained}) than this one ({task.setting})"
    else:
        difference = "for another definition of the task, with other forces, speeds or phases than today's"
    raise ValueError(
        f"{which} was trained {difference}, so it is not used. Attempt with --generator planner_only, or train a "
        f"policy, `dynaforge forge --task {task.name}`, and pass it as --policy."
    )


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
