"""The definition of one training run of a comparison: task, variant, seed, and how its final policy is evaluated."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from dynaforge.sim import Condition
from dynaforge.tasks import Stream, Task, get_task
from dynaforge.tasks.digest import task_digest
from dynaforge.training.run_archive import is_finished, read_run
from dynaforge.training.settings import hyperparameters

PLANNER_ONLY = "planner_only"
"""The variant that trains nothing and evaluates the planner."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The conditions on which a final policy is evaluated.

    Attributes:
        stream: Name of the condition stream.
        blocks: How many blocks of the stream.
        attempts: How many conditions of each block.
    """

    stream: Stream = "test"
    blocks: int = 3
    attempts: int = 100

    def conditions(self, task: Task) -> Iterator[tuple[int, Condition]]:
        """Yield every condition with the number of its block."""
        for block in range(self.blocks):
            for condition in islice(task.conditions.stream(self.stream, block), self.attempts):
                yield block, condition


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSpec:
    """A training run: what it learns, how, and how it is evaluated.

    Attributes:
        task: Task name, or path of a task file.
        variant: Name of the variant in tables; `PLANNER_ONLY` trains nothing.
        algo: Name of a file in zoo_configs, without its ending.
        changes: Settings in which the variant differs from that file.
        seed: Training seed.
        steps: Environment steps to train for; the update under way is finished.
        evaluation: Conditions on which the final policy is evaluated.
        folder: Where the run is stored.
    """

    task: str
    variant: str
    algo: str
    changes: Mapping[str, Any]
    seed: int
    steps: int
    evaluation: Evaluation
    folder: Path

    def to_json(self) -> str:
        """Return the spec as one line of JSON."""
        return json.dumps(self._stored() | {"folder": str(self.folder)})

    @staticmethod
    def from_json(text: str) -> RunSpec:
        """Read what `to_json` wrote."""
        data = json.loads(text)
        variant, evaluation = data.pop("arm"), Evaluation(**data.pop("exam"))
        return RunSpec(**data | {"variant": variant, "evaluation": evaluation, "folder": Path(data["folder"])})

    def identity(self) -> dict[str, Any]:
        """Return what identifies the run as plain JSON data: not its folder or its task file, which may move."""
        task = get_task(self.task)
        definition = {"task_definition": task_digest(task)} if self.task != task.name else {}
        return self._stored() | {"task": task.name} | definition

    def settings(self) -> dict[str, Any]:
        """Return the hyperparameters: those of zoo_configs with the changes of the variant."""
        settings = hyperparameters(self.algo, self.task, self.changes)
        return {name: value for name, value in settings.items() if name != "n_timesteps"}  # `steps` replaces it

    @property
    def finished(self) -> bool:
        """Whether the run is complete, its evaluation included."""
        return is_finished(self.folder)

    def check(self) -> None:
        """Check that its folder, or the archive of its task, contains no other run than this one.

        Raises:
            ValueError: There is another run, or one with settings that zoo_configs no longer has.
        """
        path = self.folder / "run.json"
        in_folder = path.is_file()
        archived: Any = None if in_folder else read_run(self.folder).get("run.json")
        if not in_folder and archived is None:
            return  # nothing is stored yet
        try:
            metadata = json.loads(path.read_text()) if in_folder else archived
            stored = metadata["run"] | {"settings": metadata["settings"]}
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(
                f"{path} does not describe a run ({error!r}). Choose another --out, or remove it."
            ) from None
        requested = self.identity() | {"settings": json.loads(json.dumps(self.settings()))}
        # The changes are part of the settings, which are compared as a whole.
        differ = [name for name in requested if name != "changes" and requested[name] != stored.get(name)]
        if differ:
            was, now = ({name: side.get(name) for name in differ} for side in (stored, requested))
            raise ValueError(
                f"{self.folder} holds a run with {was}, now {now} is asked for. Choose another --out, or remove it."
            )

    def _stored(self) -> dict[str, Any]:
        """Return the fields under their stored names, without the folder."""
        return {
            "task": self.task,
            "arm": self.variant,
            "algo": self.algo,
            "changes": dict(self.changes),
            "seed": self.seed,
            "steps": self.steps,
            "exam": asdict(self.evaluation),
        }
