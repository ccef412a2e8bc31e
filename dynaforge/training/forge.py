"""The training stage of `dynaforge forge`: within a budget of time, stored after every update."""

from __future__ import annotations

from dataclasses import dataclass

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.tasks import Task
from dynaforge.training.forge_folder import ForgeFolder
from dynaforge.training.history import TrainingHistory
from dynaforge.training.model import decaying_within, save_model, training_env
from dynaforge.training.monitor import TimeLimit
from dynaforge.training.settings import hyperparameters
from dynaforge.training.stored_training import HISTORY, StoredTraining

POLICY = "policy.safetensors"


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """What `train` returns.

    Attributes:
        policy: The policy at the end.
        history: One row per update.
        interrupted: Whether Ctrl-C ended the training, so that the same call resumes it.
    """

    policy: MlpPolicyFile
    history: TrainingHistory
    interrupted: bool


def train(
    task: Task, folder: ForgeFolder, *, algo: str, seed: int, seconds: float, updates: int | None, workers: int
) -> TrainingResult:
    """Train until the time or the updates are up; every update is stored, and a later call resumes.

    Args:
        task: What is learned.
        folder: Where history, training checkpoint and policy are stored.
        algo: File of zoo_configs.
        seed: Training seed.
        seconds: Wall time allowed, that of interrupted calls included.
        updates: Updates allowed; None for no limit.
        workers: Cores to collect on.
    """
    path = folder.path
    if folder.has_stage("trained"):
        return TrainingResult(MlpPolicyFile.load(path / POLICY, task=task), TrainingHistory.load(path / HISTORY), False)
    settings = hyperparameters(algo, task.name)
    env = training_env(task, settings["n_envs"], algo=algo, cores=workers)
    interrupted = False
    try:
        counting = {} if algo == "ppo" else {"timesteps": "gated"}
        training = StoredTraining(path, task, env, algo=algo, seed=seed, **counting)
        if training.resumed:
            print(f"      resuming after {len(training.history)} updates")
        limit = TimeLimit(training.history, seconds=seconds, updates=updates)

        def save() -> MlpPolicyFile:
            policy = training.policy()
            training.save()
            policy.save(path / POLICY)
            return policy

        def between_updates(made: int) -> bool:
            if made:
                save()
            return limit(made)

        try:
            with decaying_within(training.model, limit.used):
                training.learn(int(settings["n_timesteps"]), between_updates)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            limit.close()
        policy = save()
        save_model(training.model, path / "model.zip")
    finally:
        env.close()
    if not interrupted:
        folder.stage("trained", lambda: {"updates": len(training.history), "policy": policy.digest})
    return TrainingResult(policy, training.history, interrupted)
