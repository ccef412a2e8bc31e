"""Generators by the names that commands use, and the policies that they run."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from dynaforge.algos.policy_file import POLICY_FILE, MlpPolicyFile
from dynaforge.generators.dmp_generator import DmpGenerator
from dynaforge.generators.dmp_source import read_source, record_source
from dynaforge.generators.generator import ExploringPolicy, Generator, PlannerOnly, ResidualGenerator
from dynaforge.generators.learner import LearnerGenerator
from dynaforge.generators.names import GENERATORS, Level, Speed
from dynaforge.generators.oracle import Oracle
from dynaforge.generators.prediction import Prediction, chosen_lead_time
from dynaforge.generators.replay import SynchronisedReplay
from dynaforge.generators.state_machine import StateMachineGenerator
from dynaforge.generators.static_scenes import check_supported
from dynaforge.sim.prescribed import Release
from dynaforge.sim.setting import Setting
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import Task, task_file_name
from dynaforge.tasks.digest import definition_of


def make_generator(
    name: str,
    task: Task,
    *,
    policy: Path | None = None,
    lead_time: float | None = None,
    source: Path | None = None,
    sigma: float = 0.25,
    oracle_tries: int = 64,
    learner: str | None = None,
    observations: Path | None = None,
    level: Level = 1,
    release: Release = "end",
    object_speed: Speed = "shipped",
    chosen: Collection[str] = (),
) -> Generator:
    """Return a new generator.

    Args:
        name: One of `GENERATORS`.
        task: What it attempts.
        policy: Policy file for "residual" and "exploring"; None takes the one that is shipped for the task.
        lead_time: Seconds of constant-velocity prediction for "prediction"; None takes the stored choice.
        source: Recording of a source demonstration for "dmp"; None records one here, which takes seconds.
        sigma: Standard deviation of the noise for "exploring", in units of the residual action.
        oracle_tries: Residuals that "oracle" tries on each condition.
        learner: Where the policy of "learner" comes from: "module:function" or "file.py:function".
        observations: Folder of `dynaforge render` whose settings the observations of "learner" are made with.
        level: Shape of the object's path for "replay", as `SynchronisedReplay` takes it.
        release: When physics takes over for "replay", likewise.
        object_speed: Cap on the object's speed for "replay", likewise.
        chosen: Parts of the task's setting in which a policy may have been trained otherwise; see `policy_for`.

    Raises:
        ValueError: The name is unknown, the generator is not for this task, or the policy file or the source does not
            fit the task, or there is none.
    """
    match name:
        case "planner_only":
            return PlannerOnly()
        case "prediction":
            return Prediction(chosen_lead_time(task) if lead_time is None else lead_time)
        case "dmp":
            return DmpGenerator(record_source(task) if source is None else read_source(source, task), task)
        case "residual":
            trained = policy_for(task, policy, chosen=chosen)
            return ResidualGenerator(trained, policy_hash=trained.digest, trained_under=setting_of(trained))
        case "exploring":
            trained = policy_for(task, policy, chosen=chosen)
            return ResidualGenerator(
                ExploringPolicy(trained, sigma),
                policy_hash=trained.digest,
                name=name,
                trained_under=setting_of(trained),
            )
        case "oracle":
            return Oracle(m=oracle_tries)
        case "replay":
            check_supported(task)
            return SynchronisedReplay(level=level, release=release, speed=object_speed)
        case "state_machine":
            return StateMachineGenerator(task)
        case "learner" if learner is not None:
            return _make_learner(learner, observations)
    raise ValueError(f"No generator {name!r}; known are {', '.join(GENERATORS)}.")


def policy_for(task: Task, path: str | Path | None = None, *, chosen: Collection[str] = ()) -> MlpPolicyFile:
    """Read a policy and check that it was trained for a task, as it is now and in its setting.

    Args:
        task: The task.
        path: The policy file; None takes the one that is shipped for the task.
        chosen: Parts of the task's setting, "reflex", "physics" or "sensing", that were chosen on purpose: in these
            the policy may have been trained otherwise.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: None is shipped, or the file is damaged, of another task or of other sizes than the task's env, or
            was trained for another definition or under another setting of the task.
    """
    policy = MlpPolicyFile.load(shipped_policy(task) if path is None else path, task=task)
    if fault := _fault_of(policy, task, chosen):
        raise ValueError(f"{f'The shipped policy of {task.name!r}' if path is None else path} was trained {fault}")
    return policy


def setting_of(policy: MlpPolicyFile) -> Setting | None:
    """Return the setting that a policy was trained under; None where its file tells none that can be read."""
    try:
        return Setting.from_dict(policy.meta.get("setting"))
    except ValueError:
        return None


def setting_line(task: Task, generators: Iterable[Generator]) -> str:
    """Return the setting of a task in words, and the other one that a policy of the generators was trained under."""
    trained = {getattr(generator, "trained_under", None) for generator in generators} - {None, task.setting}
    others = " and ".join(sorted(map(str, trained)))
    return f"trained under {others}; run under {task.setting}" if others else str(task.setting)


def _fault_of(policy: MlpPolicyFile, task: Task, chosen: Collection[str]) -> str:
    """Say why a policy must not run in a task, after "was trained", and what to do; "" if it may."""
    trained, meta, here = setting_of(policy), policy.meta, definition_of(task)
    if trained == task.setting and meta.get("task_definition") == here["task_definition"]:
        return ""
    if trained in (None, task.setting) or meta.get("in_any_setting") != here["in_any_setting"]:
        file = task_file_name(task) or task.name
        return (
            f"for another definition of the task ({_what_differs(policy)}), so it is not used. "
            f"Use --generator planner_only, or train one: dynaforge forge --task {file}."
        )
    assert trained is not None
    theirs, ours = trained.words(), task.setting.words()
    unchosen = [name for name in ours if theirs[name] != ours[name] and name not in chosen]
    if not unchosen:
        return ""
    as_trained, as_here = (" ".join(f"--{name} {words[name]}" for name in unchosen) for words in (theirs, ours))
    return (
        f"under another setting ({trained}) than this one ({task.setting}). Give {as_trained} to run it as it was "
        f"trained, or {as_here} to run it in this one on purpose."
    )


def _what_differs(policy: MlpPolicyFile) -> str:
    if "setting" not in policy.meta:
        return "rigid arm, no force reflex"
    if setting_of(policy) is None:
        return "its setting is unreadable"
    return "other scene, conditions, phases or residual"


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
