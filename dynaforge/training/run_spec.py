"""The definition of one training run of a comparison: task, variant, seed, and how its final policy is evaluated."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from dynaforge.sim import Condition
from dynaforge.sim.setting import Setting
from dynaforge.tasks import Stream, Task, get_task
from dynaforge.tasks.digest import definition_of
from dynaforge.training.run_archive import EVALUATED, is_finished, read_run
from dynaforge.training.settings import hyperparameters

PLANNER_ONLY = "planner_only"
"""The variant that trains nothing and evaluates the planner."""

OLDER_PHYSICS = "older physics"
"""The setting, in words, of stored runs that name none: a rigid arm, no force reflex, nothing hidden."""


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
        setting: The setting in which the task is trained and evaluated.
        variant: Name of the variant in tables; `PLANNER_ONLY` trains nothing.
        algo: Name of a file in zoo_configs, without its ending.
        changes: Settings in which the variant differs from that file.
        seed: Training seed.
        steps: Environment steps to train for; the update under way is finished.
        evaluation: Conditions on which the final policy is evaluated.
        folder: Where the run is stored.
    """

    task: str
    setting: Setting
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
        rebuilt = {"variant": variant, "evaluation": evaluation, "folder": Path(data["folder"])}
        return RunSpec(**data | rebuilt | {"setting": Setting.from_dict(data["setting"])})

    def make_task(self) -> Task:
        """Return the task in its setting."""
        return get_task(self.task).under(**self.setting.to_dict())

    def identity(self) -> dict[str, Any]:
        """Return what identifies the run as plain JSON data: not its folder or its task file, which may move."""
        task = self.make_task()
        return self._stored() | {"task": task.name} | definition_of(task)

    def settings(self) -> dict[str, Any]:
        """Return the hyperparameters: those of zoo_configs with the changes of the variant."""
        settings = hyperparameters(self.algo, self.task, self.changes)
        return {name: value for name, value in settings.items() if name != "n_timesteps"}  # `steps` replaces it

    @property
    def finished(self) -> bool:
        """Whether the run is complete, its evaluation included."""
        return is_finished(self.folder)

    def check(self, *, definition: bool = True) -> None:
        """Check that its folder, or the archive of its task, contains no other run than this one.

        Args:
            definition: Whether a run in another setting, or of another definition of the task, is another run.

        Raises:
            ValueError: There is another run, or one with settings that zoo_configs no longer has.
        """
        stored = self._found()
        if stored is None:
            return
        requested = self.identity()
        if self.variant != PLANNER_ONLY:
            requested |= {"settings": json.loads(json.dumps(self.settings()))}
        if definition and stored.get("task_definition") != requested["task_definition"]:
            raise ValueError(
                f"{self.folder} holds a run {self._difference_from(stored)}. Choose another --out, or --report-only "
                "without a setting to report what is stored."
            )
        # The changes are part of the settings, which are compared as a whole.
        ignored = ("changes", *definition_of(self.make_task()))
        differ = [name for name in requested if name not in ignored and requested[name] != stored.get(name)]
        if differ:
            was, now = ({name: side.get(name) for name in differ} for side in (stored, requested))
            raise ValueError(
                f"{self.folder} holds a run with {was}, now {now} is asked for. Choose another --out, or remove it."
            )

    def _found(self) -> dict[str, Any] | None:
        """Return what identifies the run that is stored, as `identity` does, and its settings; None without one."""
        path = self.folder / "run.json"
        files = {} if path.is_file() else read_run(self.folder)
        found: dict[str, Any] | None = None
        try:
            if path.is_file() or "run.json" in files:
                metadata = json.loads(path.read_text()) if path.is_file() else files["run.json"]
                found = metadata["run"] | {"settings": metadata["settings"]}
            elif EVALUATED in files and self.variant == PLANNER_ONLY:  # which stores its evaluation only
                found = self.identity() | dict.fromkeys(definition_of(self.make_task())) | files[EVALUATED]
            if found is not None:
                setting_in_words(found.get("setting"))
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(
                f"{path} does not describe a run ({error!r}). Choose another --out, or remove it."
            ) from None
        return found

    def _difference_from(self, stored: Mapping[str, Any]) -> str:
        made_under = setting_in_words(stored.get("setting"))
        if made_under == str(self.setting):
            return f"of another definition of task {stored['task']!r} than the present one"
        return f"made under {made_under}, now {self.setting} is asked for"

    def _stored(self) -> dict[str, Any]:
        """Return the fields under their stored names, without the folder."""
        return {
            "task": self.task,
            "setting": self.setting.to_dict(),
            "arm": self.variant,
            "algo": self.algo,
            "changes": dict(self.changes),
            "seed": self.seed,
            "steps": self.steps,
            "exam": asdict(self.evaluation),
        }


def setting_in_words(stored: Any) -> str:
    """Return a stored setting in words; `OLDER_PHYSICS` for a run that stores none.

    Raises:
        ValueError: It is no setting.
    """
    return OLDER_PHYSICS if stored is None else str(Setting.from_dict(stored))
