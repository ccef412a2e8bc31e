"""One training run of a comparison: one core, stored as it goes, gone on with after any interruption.

`python -m dynaforge.training.run SPEC [end-with-stdin]`, which `dynaforge compare` starts, makes or finishes the run
that SPEC, the JSON form of a `RunSpec`, describes. Each line that it prints is a JSON object with its progress. With
the second argument it ends when its stdin is closed, that is when the process that started it is gone.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from dynaforge.files.atomic import atomic_write
from dynaforge.files.versions import package_versions
from dynaforge.generators import Generator, PlannerOnly, ResidualGenerator, attempt_once
from dynaforge.generators.giving_up import unless_all_raise
from dynaforge.sampling.processes import end_after
from dynaforge.sim import Condition
from dynaforge.tasks import Task, get_task
from dynaforge.tasks.digest import task_digest
from dynaforge.training.history import STRATA, Probe, TrainingHistory
from dynaforge.training.settings import hyperparameters

SAVED_EVERY = 5  # updates, between two of which a kill may fall
PROBED_EVERY = 5  # updates, between two measurements without exploration
CHECKPOINT = "checkpoint.safetensors"
END_WITH_STDIN = "end-with-stdin"


@dataclass(frozen=True, slots=True)
class Exam:
    """The conditions on which a finished policy is measured.

    Attributes:
        stream: Condition stream.
        blocks, attempts: Blocks, and conditions a block.
    """

    stream: str = "test"
    blocks: int = 3
    attempts: int = 100

    def conditions(self, task: Task) -> Iterator[tuple[int, Condition]]:
        """Iterate over (block, condition)."""
        for block in range(self.blocks):
            for condition in islice(task.conditions.stream(self.stream, block), self.attempts):
                yield block, condition


@dataclass(frozen=True, slots=True)
class RunSpec:
    """A training run: what it learns, how, and how it is measured.

    Attributes:
        task: Task name, or path of its file.
        arm: Name in tables.
        algo: File of zoo_configs.
        changes: Settings in which the arm differs from that file.
        seed: Training seed.
        steps: Environment steps; the update under way is finished.
        exam: What the final policy is measured on.
        folder: Where it is stored.
    """

    task: str
    arm: str
    algo: str
    changes: Mapping[str, Any]
    seed: int
    steps: int
    exam: Exam
    folder: Path = field(compare=False)

    def to_json(self) -> str:
        """Return it as one line."""
        return json.dumps(asdict(self), default=str)

    @staticmethod
    def from_json(text: str) -> RunSpec:
        """Read what `to_json` wrote."""
        data = json.loads(text)
        return RunSpec(**data | {"exam": Exam(**data["exam"]), "folder": Path(data["folder"])})

    def identity(self) -> dict[str, Any]:
        """Return what makes it this run, as plain JSON data; the folder and a task's file may be moved."""
        task = get_task(self.task)
        whole = json.loads(self.to_json()) | {"task": task.name}
        if self.task != task.name:
            whole["task_definition"] = task_digest(task)
        return {name: value for name, value in whole.items() if name != "folder"}

    def settings(self) -> dict[str, Any]:
        """Return the hyperparameters: those of zoo_configs and the changes."""
        settings = hyperparameters(self.algo, self.task, self.changes)
        return {name: value for name, value in settings.items() if name != "n_timesteps"}  # `steps` says it

    @property
    def finished(self) -> bool:
        """Whether it ran to its end, its exam included."""
        return (self.folder / "exam.json").is_file()

    def check(self) -> None:
        """Compare with what the folder holds.

        Raises:
            ValueError: It holds another run, or one with settings that zoo_configs has no longer.
        """
        stored = self.folder / "run.json"
        if not stored.is_file():
            return
        try:
            about = json.loads(stored.read_text())
            held = about["run"] | {"settings": about["settings"]}
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(
                f"{stored} does not describe a run ({error!r}). Choose another --out, or remove it."
            ) from None
        mine = self.identity() | {"settings": json.loads(json.dumps(self.settings()))}
        differ = [name for name in mine if name != "changes" and mine[name] != held.get(name)]  # settings hold them
        if differ:
            was, now = ({name: side.get(name) for name in differ} for side in (held, mine))
            raise ValueError(
                f"{self.folder} holds a run with {was}, now {now} is asked for. Choose another --out, or remove it."
            )


def perform(spec: RunSpec) -> None:
    """Make the run, or what is missing of it."""
    from dynaforge.training import model as training
    from dynaforge.training.checkpoint import load_checkpoint, save_checkpoint

    spec.check()
    spec.folder.mkdir(parents=True, exist_ok=True)
    settings = spec.settings()
    about = {"run": spec.identity(), "settings": settings, "versions": package_versions()}
    atomic_write(spec.folder / "run.json", json.dumps(about, indent=1).encode() + b"\n")
    task = get_task(spec.task)
    env = training.training_env(task, settings["n_envs"], cores=1)
    checkpoint, stored = spec.folder / CHECKPOINT, spec.folder / "history.json"
    model = training.build_model(spec.task, env, algo=spec.algo, seed=spec.seed, **spec.changes)
    history = TrainingHistory()
    if checkpoint.is_file():
        load_checkpoint(model, checkpoint, seed=spec.seed)
        history = TrainingHistory.load(stored).up_to(model.num_timesteps)
    prober = Prober(task)

    def policy() -> Any:
        return training.policy_file(model, task.name, algo=spec.algo, seed=spec.seed, updates=len(history))

    def between_updates(updates: int) -> bool:
        last = history.probes[-1].update if history.probes else -1
        if updates % PROBED_EVERY == 0 and updates > last:
            steps = history.timesteps[-1] if history.timesteps else 0
            history.probes.append(prober.probe(policy(), update=updates, timesteps=steps))
        if updates and updates % SAVED_EVERY == 0:
            history.save(stored)  # first: a history longer than its checkpoint is cut, a shorter one would have a hole
            save_checkpoint(model, checkpoint)
        if updates:
            tell(steps=min(history.timesteps[-1], spec.steps), text=training.describe_update(history))
        return True

    left = spec.steps - model.num_timesteps
    if left > 0:
        monitor = training.TrainingMonitor(history, task.conditions, between_updates)
        model.learn(left, callback=monitor, reset_num_timesteps=not checkpoint.is_file())
    env.close()
    history.save(stored)
    save_checkpoint(model, checkpoint)
    final = policy()
    final.save(spec.folder / "policy.safetensors")
    examine(task, ResidualGenerator(final, policy_hash=final.digest), spec.exam, spec.folder / "exam.json")
    checkpoint.unlink()


def examine(task: Task, generator: Generator, exam: Exam, path: Path) -> None:
    """Measure a generator on an exam's conditions, in this process, and store every outcome.

    Raises:
        GaveUp: It only raises, so that there is nothing to measure.
    """
    from dynaforge.envs.residual_env import ResidualEnv

    env = ResidualEnv(task)
    rows = []
    results = (attempt_once(env, generator, condition) for _, condition in exam.conditions(task))
    sound = unless_all_raise(results, generator=generator.name)
    for (block, condition), result in zip(exam.conditions(task), sound, strict=True):
        attempt = result.attempt
        outcome = "success" if attempt.success else attempt.failure
        rows.append({"block": block, "id": condition.id, "difficulty": condition.difficulty, "outcome": outcome})
        tell(text=f"measuring on {exam.stream}, {len(rows)} of {exam.blocks * exam.attempts}")
    env.close()
    data = {"task": task.name, "generator": generator.name, "exam": asdict(exam), "versions": package_versions()}
    lines = ",\n  ".join(json.dumps(row) for row in rows)
    text = json.dumps(data, indent=1)[:-2] + f',\n "attempts": [\n  {lines}\n ]\n}}\n'
    atomic_write(path, text.encode())


class Prober:
    """Measures a policy without exploration on one `val` condition of every stratum, others at every call."""

    def __init__(self, task: Task) -> None:
        from dynaforge.envs.residual_env import ResidualEnv

        self._task = task
        self._env = ResidualEnv(task)

    def probe(self, policy: Any, *, update: int, timesteps: int) -> Probe:
        """Run the episodes; equal updates meet equal conditions, whatever is trained."""
        generator = ResidualGenerator(policy)
        conditions = islice(self._task.conditions.stream("val", update, n_strata=STRATA), STRATA)
        won = [generator.attempt(self._env, condition).success for condition in conditions]
        return Probe(update, timesteps, won)


def tell(**what: Any) -> None:
    """Report to whoever started this process."""
    print(json.dumps(what), flush=True)


def main() -> int:
    """Make the run, or measure the planner, that the first argument describes."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if sys.argv[2:] == [END_WITH_STDIN]:
        end_after(sys.stdin.fileno())
    spec = RunSpec.from_json(sys.argv[1])
    if spec.arm == "planner_only":
        examine(get_task(spec.task), PlannerOnly(), spec.exam, spec.folder / "exam.json")
    else:
        perform(spec)
    return 0


if __name__ == "__main__":
    sys.exit(main())
