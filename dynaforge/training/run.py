"""One training run of a comparison: on one core, stored as it proceeds, resumed after any interruption.

`dynaforge compare` starts `python -m dynaforge.training.run SPEC [end-with-stdin]`, where SPEC is a `RunSpec` as JSON,
to make or resume that run. Each line that it prints is a JSON object with its progress. With the second argument it
ends when its stdin is closed, that is, when the process that started it is gone.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Any

from dynaforge.algos.policy_file import POLICY_FILE
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions
from dynaforge.generators import Generator, PlannerOnly, ResidualGenerator, attempt_once
from dynaforge.generators.giving_up import refuse_if_all_raise
from dynaforge.sampling.processes import end_after
from dynaforge.tasks import Task
from dynaforge.tasks.digest import definition_of
from dynaforge.training.history import STRATA, Probe
from dynaforge.training.run_archive import EVALUATED
from dynaforge.training.run_spec import PLANNER_ONLY, Evaluation, RunSpec

SAVED_EVERY = 5  # updates; a kill loses at most this many
PROBED_EVERY = 5  # updates
END_WITH_STDIN = "end-with-stdin"


def train(spec: RunSpec) -> None:
    """Make the run, or resume it where it stopped."""
    from dynaforge.training.model import training_env
    from dynaforge.training.monitor import describe_update
    from dynaforge.training.stored_training import StoredTraining

    spec.check()
    spec.folder.mkdir(parents=True, exist_ok=True)
    settings = spec.settings()
    metadata = {"run": spec.identity(), "settings": settings, "versions": package_versions()}
    atomic_write(spec.folder / "run.json", json.dumps(metadata, indent=1).encode() + b"\n")
    task = spec.make_task()
    env = training_env(task, settings["n_envs"], cores=1)
    training = StoredTraining(spec.folder, task, env, algo=spec.algo, seed=spec.seed, **spec.changes)
    history, prober = training.history, Prober(task)

    def between_updates(updates: int) -> bool:
        last_probed = history.probes[-1].update if history.probes else -1
        if updates % PROBED_EVERY == 0 and updates > last_probed:
            steps = history.timesteps[-1] if history.timesteps else 0
            history.probes.append(prober.probe(training.policy(), update=updates, timesteps=steps))
        if updates and updates % SAVED_EVERY == 0:
            training.save()
        if updates:
            report_progress(steps=min(history.timesteps[-1], spec.steps), text=describe_update(history))
        return True

    training.learn(spec.steps, between_updates)
    env.close()
    training.save()
    policy = training.policy()
    policy.save(spec.folder / POLICY_FILE)
    evaluate(task, ResidualGenerator(policy, policy_hash=policy.digest), spec.evaluation, spec.folder / EVALUATED)
    training.checkpoint.unlink()


def evaluate(task: Task, generator: Generator, evaluation: Evaluation, path: Path) -> None:
    """Evaluate a generator in this process and store every outcome.

    Args:
        task: The task.
        generator: What attempts it.
        evaluation: The conditions.
        path: The JSON file to write.

    Raises:
        GaveUp: The generator only raises, so that there is nothing to measure.
    """
    env = ResidualEnv(task)
    conditions = list(evaluation.conditions(task))
    results = (attempt_once(env, generator, condition) for _, condition in conditions)
    sound = refuse_if_all_raise(results, generator=generator.name)
    rows = []
    for (block, condition), result in zip(conditions, sound, strict=True):
        outcome = str(result.attempt.outcome)
        rows.append({"block": block, "id": condition.id, "difficulty": condition.difficulty, "outcome": outcome})
        report_progress(text=f"measuring on {evaluation.stream}, {len(rows)} of {len(conditions)}")
    env.close()
    header = {
        "task": task.name,
        "generator": generator.name,
        "exam": asdict(evaluation),
        **definition_of(task),
        "versions": package_versions(),
    }
    atomic_write(path, _one_line_per_attempt(header, rows).encode())


def _one_line_per_attempt(header: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Return JSON with the keys of the header, and below them "attempts" with one line per row."""
    opened = json.dumps(header, indent=1).removesuffix("\n}")
    lines = ",\n  ".join(json.dumps(row) for row in rows)
    return f'{opened},\n "attempts": [\n  {lines}\n ]\n}}\n'


class Prober:
    """Evaluates a policy without exploration noise on one `val` condition of every stratum, new ones at every update.

    Args:
        task: The task.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._env = ResidualEnv(task)

    def probe(self, policy: Any, *, update: int, timesteps: int) -> Probe:
        """Attempt the conditions of an update, which are the same for every run.

        Args:
            policy: Maps an observation to a residual action.
            update: Updates made so far.
            timesteps: Environment steps made so far.
        """
        generator = ResidualGenerator(policy)
        conditions = islice(self._task.conditions.stream("val", update, n_strata=STRATA), STRATA)
        success = [generator.attempt(self._env, condition).success for condition in conditions]
        return Probe(update, timesteps, success)


def report_progress(**progress: Any) -> None:
    """Tell the process that started this one how far the run is."""
    print(json.dumps(progress), flush=True)


def main() -> int:
    """Make the run that the first argument describes."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if sys.argv[2:] == [END_WITH_STDIN]:
        end_after(sys.stdin.fileno())
    spec = RunSpec.from_json(sys.argv[1])
    if spec.variant == PLANNER_ONLY:
        evaluate(spec.make_task(), PlannerOnly(), spec.evaluation, spec.folder / EVALUATED)
    else:
        train(spec)
    return 0


if __name__ == "__main__":
    sys.exit(main())
