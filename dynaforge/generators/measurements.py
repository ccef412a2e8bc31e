"""What a generator did on the conditions of a task, as one JSON file: everything that a table says of it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dynaforge.demos import Attempt
from dynaforge.files.atomic import atomic_write
from dynaforge.geometry import one_line
from dynaforge.sim.loads import Loads

_ROWS = "attempts"


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredAttempt:
    """One attempt, in as much as tables are about it; it is an `AttemptRecord` of `dynaforge.evaluation.dgr`.

    Attributes:
        id: Id of the condition.
        block: Number of the block that it belongs to.
        difficulty: Nominal difficulty of the condition, in the task's unit.
        speed: Speed of what moves, m/s; None for a task whose conditions have none.
        success: Whether it succeeded.
        failure: Why not; "" on success.
        loads: The greatest external loads on the robot; None where they are not known.
        wall_seconds: Real time that it took.
        cpu_seconds: Processor time that it took; None where it is not known.
    """

    id: str
    block: int
    difficulty: float
    speed: float | None
    success: bool
    failure: str
    loads: Loads | None
    wall_seconds: float
    cpu_seconds: float | None = None

    @staticmethod
    def of(attempt: Attempt, *, speed: str | None) -> MeasuredAttempt:
        """Return what is kept of an attempt; `speed` is the field of its condition that is the speed."""
        return MeasuredAttempt(
            id=attempt.condition.id,
            block=attempt.block,
            difficulty=attempt.difficulty,
            speed=None if speed is None else attempt.condition.values[speed],
            success=attempt.success,
            failure=attempt.failure,
            loads=attempt.loads,
            wall_seconds=round(attempt.wall_seconds, 4),
            cpu_seconds=None if attempt.cpu_seconds is None else round(attempt.cpu_seconds, 4),
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Measurement:
    """The attempts of a generator on a task.

    Attributes:
        header: Plain JSON data: `task`, `row` (name of the generator in tables), `identity` (what must agree for
            attempts to be added), `definition` (of the task, by whatever generator), and what tables say beside the
            attempts: `skill`, `unit`, `difficulty_range`, `speed_range`.
        attempts: In the order of the conditions.
    """

    header: Mapping[str, Any]
    attempts: Sequence[MeasuredAttempt]

    __repr__ = one_line

    @property
    def task(self) -> str:
        """Name of the task."""
        return str(self.header["task"])

    @property
    def row(self) -> str:
        """Name of the generator in tables."""
        return str(self.header["row"])

    @property
    def success(self) -> list[bool]:
        """Success of each attempt."""
        return [attempt.success for attempt in self.attempts]

    @property
    def ids(self) -> list[str]:
        """Ids of the conditions."""
        return [attempt.id for attempt in self.attempts]

    def save(self, path: Path) -> None:
        """Write it, in one step, as JSON with one line for each attempt; its folder is made if there is none."""
        opened = json.dumps(dict(self.header), indent=1).removesuffix("\n}")
        lines = ",\n  ".join(json.dumps(asdict(attempt)) for attempt in self.attempts)
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, f'{opened},\n "{_ROWS}": [\n  {lines}\n ]\n}}\n'.encode())

    @staticmethod
    def load(path: Path) -> Measurement:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is damaged.
        """
        try:
            header = json.loads(path.read_text(encoding="utf-8"))
            attempts = [
                MeasuredAttempt(**{**row, "loads": row["loads"] and Loads.from_dict(row["loads"])})
                for row in header.pop(_ROWS)
            ]
            for name in ("task", "row", "definition", "skill", "unit"):
                if not isinstance(header[name], str):
                    raise ValueError(f"{name} is no text")
            for name in ("difficulty_range", "speed_range"):
                if header[name] is not None:
                    low, high = map(float, header[name])
                    header[name] = (low, high)
            if not isinstance(header["identity"], dict):
                raise ValueError("identity is no mapping")
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"{path} holds no measurement ({type(error).__name__}: {error}). Remove it.") from None
        return Measurement(header=header, attempts=attempts)
