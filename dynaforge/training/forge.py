"""The training stage of `dynaforge forge`: limited by a time budget, stored after every update."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import POLICY_FILE, MlpPolicyFile
from dynaforge.generators.by_name import policy_for
from dynaforge.tasks import Task
from dynaforge.training.forge_folder import ForgeFolder
from dynaforge.training.history import TrainingHistory
from dynaforge.training.model import ALGORITHMS, decaying_within, save_model, training_env
from dynaforge.training.monitor import TimeLimit
from dynaforge.training.settings import hyperparameters
from dynaforge.training.stored_training import HISTORY, StoredTraining


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """What the training stage made.

    Attributes:
        policy: The policy at its end.
        history: One row per update.
        interrupted: Whether Ctrl-C ended it; the same call then resumes it.
    """

    policy: MlpPolicyFile
    history: TrainingHistory
    interrupted: bool


def train(
    task: Task, folder: ForgeFolder, *, algo: str, seed: int, seconds: float, updates: int | None, workers: int
) -> TrainingResult:
    """Train until the time or the updates are used up; every update is stored, and a later call resumes.

    Args:
        task: The task.
        folder: Where history, training checkpoint and policy are stored.
        algo: Name of a file in zoo_configs.
        seed: Training seed.
        seconds: Wall time allowed, that of interrupted calls included.
        updates: Updates allowed; None for no limit.
        workers: Cores to collect on.
    """
    path = folder.path
    if folder.has_stage("trained"):
        policy, history = policy_for(task, path / POLICY_FILE), TrainingHistory.load(path / HISTORY)
        return TrainingResult(policy, history, interrupted=False)
    settings = hyperparameters(algo, task.name)
    env = training_env(task, settings["n_envs"], algo=algo, cores=workers)
    try:
        counting = {"timesteps": "gated"} if ALGORITHMS[algo] is FrontierGRPO else {}
        training = StoredTraining(path, task, env, algo=algo, seed=seed, **counting)
        if training.resumed:
            print(f"      resuming after {len(training.history)} updates")
        limit = TimeLimit(training.history, seconds=seconds, updates=updates)
        interrupted = _learn(training, limit, path, timesteps=int(settings["n_timesteps"]))
        policy = _save(training, path)
        save_model(training.model, path / "model.zip")
    finally:
        env.close()
    if not interrupted:
        folder.stage("trained", lambda: {"updates": len(training.history), "policy": policy.digest})
    return TrainingResult(policy, training.history, interrupted)


def _learn(training: StoredTraining, limit: TimeLimit, path: Path, *, timesteps: int) -> bool:
    """Train within the limit and store every update; return whether Ctrl-C ended it."""

    def between_updates(updates: int) -> bool:
        if updates:
            _save(training, path)
        return limit(updates)

    try:
        with decaying_within(training.model, limit.used):
            training.learn(timesteps, between_updates)
    except KeyboardInterrupt:
        return True
    finally:
        limit.close()
    return False


def _save(training: StoredTraining, path: Path) -> MlpPolicyFile:
    """Store history, training checkpoint and policy in a folder; return the policy."""
    policy = training.policy()
    training.save()
    policy.save(path / POLICY_FILE)
    return policy
