"""Pairs of a generator and a task, measured one by one; what is measured is kept, and a killed run goes on from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

from dynaforge.files.versions import package_versions
from dynaforge.generators.collecting import Engine
from dynaforge.generators.generator import Generator, attempted_task
from dynaforge.generators.measure import Until, measure, never
from dynaforge.generators.measurements import MeasuredAttempt, Measurement
from dynaforge.sim import Condition
from dynaforge.sim.setting import Setting
from dynaforge.tasks import Stream, Task
from dynaforge.tasks.digest import definition_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A generator on a task, and the conditions that it attempts: equal for all generators on the task.

    Attributes:
        task: The task.
        row: Name of the generator in tables, which tells policies of one generator apart.
        generator: The generator.
        stream: Stream of the conditions.
        blocks: Number of blocks.
        attempts: Number of conditions of each block.
        path: The JSON file of what is measured.
    """

    task: Task
    row: str
    generator: Generator
    stream: Stream
    blocks: int
    attempts: int
    path: Path

    @property
    def total(self) -> int:
        """Number of conditions."""
        return self.blocks * self.attempts

    @property
    def identity(self) -> dict[str, Any]:
        """What must agree for attempts to be of this pair, as plain JSON data."""
        return {
            "generator": self.generator.name,
            "policy": getattr(self.generator, "policy_hash", ""),
            "stream": self.stream,
            "blocks": self.blocks,
            "attempts": self.attempts,
            **definition_of(attempted_task(self.generator, self.task)),
        }

    def stored(self) -> Measurement | None:
        """Return what was measured before, complete or not; None if nothing was.

        Raises:
            ValueError: The file is damaged, or holds something else than a measurement of this pair.
        """
        if not self.path.exists():
            return None
        found = Measurement.load(self.path)
        was, now = dict(found.header["identity"]), self.identity
        differ = [name for name in now if was.get(name) != now[name]]
        if not differ:
            return found
        told = [name for name in differ if name not in ("task_definition", "in_any_setting")]
        if not told:
            raise ValueError(
                f"{self.path} was measured with another definition of task {self.task.name!r} than the present one. "
                "Choose another --out, or remove it."
            )
        then, asked = (", ".join(f"{name} {_in_words(name, side.get(name))}" for name in told) for side in (was, now))
        raise ValueError(
            f"{self.path} was measured with {then}, now {asked} is asked for. Choose another --out, or remove it."
        )

    def measure(
        self,
        *,
        workers: int | None = None,
        engine: Engine | None = None,
        until: Until = never,
    ) -> Measurement:
        """Attempt the conditions that are left, store everything, and return it.

        Args:
            workers: As in `dynaforge.generators.measure`.
            engine: As there.
            until: Called with every attempt, stored ones first; where it returns True, nothing more is attempted.

        Raises:
            ValueError: As in `stored`.
            GaveUp: The generator only raises, so that there is nothing to measure.
        """
        before = self.stored()
        done = list(before.attempts) if before else []
        verdicts = [until(attempt) for attempt in done]  # on all of them, since it may keep count
        if before is not None and (len(done) >= self.total or any(verdicts)):
            return before
        speed = self.task.conditions.speed
        new = measure(
            self.task,
            self.generator,
            self._left(len(done)),
            total=self.total - len(done),
            workers=workers,
            engine=engine,
            until=until,
        )
        result = Measurement(
            header=self._header(), attempts=[*done, *(MeasuredAttempt.of(attempt, speed=speed) for attempt in new)]
        )
        result.save(self.path)
        return result

    def _left(self, done: int) -> Iterator[Iterator[Condition]]:
        """Yield the conditions of each block but the first ones of all."""
        for block in range(self.blocks):
            skipped = min(max(done - block * self.attempts, 0), self.attempts)
            yield islice(self.task.conditions.stream(self.stream, block), skipped, self.attempts)

    def _header(self) -> dict[str, Any]:
        space = self.task.conditions
        return {
            "task": self.task.name,
            "row": self.row,
            "identity": self.identity,
            "definition": definition_of(self.task)["task_definition"],
            "skill": self.task.skill,
            "unit": space.units.get(space.difficulty, ""),
            "difficulty_range": space.difficulty_range,
            "speed_range": None if space.speed is None else space.ranges[space.speed],
            "lead_time": attempted_task(self.generator, self.task).lead_time,
            "date": datetime.now(UTC).strftime("%Y-%m-%d"),
            "versions": package_versions(),
        }


def _in_words(name: str, value: Any) -> str:
    if name == "setting":
        try:
            return f"({Setting.from_dict(value)})"
        except ValueError:
            return "unknown"
    return repr(value)
