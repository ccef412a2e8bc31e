"""One attempt at a task, successful or not: its facts, its recording, and its line in the ledger."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from types import MappingProxyType
from typing import Any

from numpy.typing import NDArray

from dynaforge.demos.prescription import FREE, PRESCRIBED
from dynaforge.demos.schema import check_meta, validate_steps
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_choice, check_flag, check_kind, check_number, check_whole, quoted
from dynaforge.sim.loads import Loads
from dynaforge.tasks.outcome import STORED, Outcome

_GENERATOR_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def episode_id(condition: Condition, generator: str) -> str:
    """Return the id of a generator's attempt at a condition: equal attempts have equal ids, so repeats are harmless.

    Raises:
        ValueError: The generator's name cannot be part of a file name.
    """
    check_generator_name(generator)
    return f"{condition.id}-{generator}"


def check_generator_name(name: Any) -> None:
    """Raise ValueError unless a generator's name can be part of a file name."""
    if not isinstance(name, str) or not _GENERATOR_NAME.fullmatch(name):
        raise ValueError(f"Generator name {quoted(name)} must consist of letters, digits, '.', '_' and '-'.")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AttemptFacts:
    """What is known of every attempt, whether or not it was recorded; `Episode` and `Attempt` share it.

    Attributes:
        condition: What fixed the episode.
        generator: Name of the generator, e.g. "planner_only" or "residual".
        outcome: How it ended.
        duration: Simulated seconds.
        loads: The greatest external loads on the robot; None where they are not known.

    Raises:
        ValueError: A field is of the wrong type or out of range.
    """

    condition: Condition
    generator: str
    outcome: Outcome
    duration: float
    loads: Loads | None = None

    def __post_init__(self) -> None:
        kind = type(self).__name__
        check_kind(f"{kind}: condition", self.condition, Condition)
        check_generator_name(self.generator)
        check_kind(f"{kind}: outcome", self.outcome, Outcome)
        check_number(f"{kind}: duration", self.duration, least=0.0)
        check_kind(f"{kind}: loads", self.loads, (Loads, type(None)))

    @property
    def id(self) -> str:
        """Condition id and generator; the file of the recording is named after it."""
        return episode_id(self.condition, self.generator)

    @property
    def difficulty(self) -> float:
        """Nominal difficulty of the condition, in the task's unit."""
        return self.condition.difficulty

    @property
    def success(self) -> bool:
        """`Outcome.success`."""
        return self.outcome.success

    @property
    def checkpoint(self) -> int:
        """`Outcome.checkpoint`."""
        return self.outcome.checkpoint

    @property
    def failure(self) -> str:
        """`Outcome.failure`."""
        return self.outcome.failure

    @property
    def phase(self) -> str:
        """`Outcome.phase`."""
        return self.outcome.phase

    @property
    def dynamics(self) -> str:
        """What moves the objects: "free", only physics; "prescribed", a path for a while."""
        return FREE

    def facts(self) -> dict[str, Any]:
        """Return these facts as plain JSON data."""
        return {
            "condition": self.condition.to_dict(),
            "generator": self.generator,
            **self.outcome.to_dict(),
            "duration": float(self.duration),
            **({} if self.loads is None else {"loads": asdict(self.loads)}),
            **({} if self.dynamics == FREE else {"dynamics": self.dynamics}),
        }


def split_facts(data: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read what `AttemptFacts.facts` returned.

    Returns:
        The fields of `AttemptFacts`, and the entries beside them as they are.

    Raises:
        ValueError: An entry is missing or malformed.
    """
    if missing := [name for name in ("condition", "generator", "duration") if name not in data]:
        raise ValueError(f"An attempt needs {', '.join(missing)}, which this one lacks.")
    fields = {
        "condition": Condition.from_dict(data["condition"]),
        "generator": data["generator"],
        "outcome": Outcome.from_dict(data),
        "duration": data["duration"],
        "loads": Loads.from_dict(data["loads"]) if "loads" in data else None,
    }
    return fields, {name: value for name, value in data.items() if name not in (*fields, *STORED)}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Episode(AttemptFacts):
    """One attempt: condition, outcome, and what was recorded at each control step.

    Attributes:
        condition, generator, outcome, duration, loads: As in `AttemptFacts`.
        steps: Arrays with leading dimension T at control rate; names, shapes, units in `SCHEMA`. Read-only.
        meta: Plain JSON data: `phases` (names by index), `versions`, `policy_hash`, `task_hash`, digests, ...
    """

    steps: Mapping[str, NDArray[Any]]
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        AttemptFacts.__post_init__(self)
        check_kind("Episode: steps", self.steps, Mapping)
        check_kind("Episode: meta", self.meta, Mapping)
        try:
            meta = json.loads(json.dumps(dict(self.meta), allow_nan=False))
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"Episode meta must be plain JSON data: {error}.") from error
        object.__setattr__(self, "steps", MappingProxyType(validate_steps(self.steps)))
        object.__setattr__(self, "meta", MappingProxyType(meta))

    @property
    def dynamics(self) -> str:
        """As in `AttemptFacts`; its `meta` says it."""
        return str(self.meta.get("dynamics", FREE))

    def __reduce__(self) -> tuple[Any, ...]:
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return partial(Episode, **given | {"steps": dict(self.steps), "meta": dict(self.meta)}), ()

    def __len__(self) -> int:
        return len(self.steps["time"]) if self.steps else 0

    def __repr__(self) -> str:
        outcome = "success" if self.success else f"failure {self.failure!r}"
        return f"Episode({self.condition.task}, {self.generator}, {outcome}, {len(self)} steps)"

    def header(self) -> dict[str, Any]:
        """Return everything but the arrays as plain JSON data."""
        return {**self.facts(), "meta": dict(self.meta)}

    @staticmethod
    def from_header(header: Mapping[str, Any], steps: Mapping[str, NDArray[Any]]) -> Episode:
        """Rebuild an episode from `header` and its arrays.

        Raises:
            ValueError: A field is missing, unknown or of another type, or the arrays do not fit the schema.
        """
        facts, rest = split_facts(header)
        check_meta(rest.get("meta"))
        episode = Episode(**facts, steps=steps, meta=rest["meta"])
        if episode.header() != dict(header):
            raise ValueError("Episode header is not one that an episode writes: unknown or rounded values.")
        return episode

    def content_hash(self) -> str:
        """Return the SHA-256 over header and arrays: the same in every process and for every file layout."""
        digest = hashlib.sha256(json.dumps(self.header(), sort_keys=True).encode())
        for name, array in self.steps.items():  # sorted by name at construction
            digest.update(f"\n{name} {array.dtype.str} {array.shape}\n".encode())
            digest.update(array.tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt(AttemptFacts):
    """A line of the ledger: one attempt, without its recording.

    Attributes:
        condition, generator, outcome, duration, loads: As in `AttemptFacts`.
        wall_seconds: Real time the attempt took; 0 where it is not known.
        cpu_seconds: Processor time that it took; None where it is not known.
        block: Which block of conditions it belongs to; standard deviations are over blocks.
        recorded: Whether its recording was kept.
        dynamics: As in `AttemptFacts`.
    """

    wall_seconds: float = 0.0
    cpu_seconds: float | None = None
    block: int = 0
    recorded: bool = False
    dynamics: str = FREE

    def __post_init__(self) -> None:
        AttemptFacts.__post_init__(self)
        check_number("Attempt: wall_seconds", self.wall_seconds, least=0.0)
        if self.cpu_seconds is not None:
            check_number("Attempt: cpu_seconds", self.cpu_seconds, least=0.0)
        check_whole("Attempt: block", self.block, least=0)
        check_flag("Attempt: recorded", self.recorded)
        check_choice("Attempt: dynamics", self.dynamics, (FREE, PRESCRIBED))

    @staticmethod
    def of(
        episode: Episode,
        *,
        wall_seconds: float = 0.0,
        cpu_seconds: float | None = None,
        block: int = 0,
        recorded: bool = False,
    ) -> Attempt:
        """Return the ledger's line of an episode.

        Args:
            episode: What happened.
            wall_seconds: Real time the attempt took; 0 where it is not known.
            cpu_seconds: Processor time that it took; None where it is not known.
            block: Which block of conditions it belongs to.
            recorded: Whether its recording was kept.
        """
        return Attempt(
            condition=episode.condition,
            generator=episode.generator,
            outcome=episode.outcome,
            duration=episode.duration,
            loads=episode.loads,
            wall_seconds=wall_seconds,
            cpu_seconds=cpu_seconds,
            block=block,
            recorded=recorded,
            dynamics=episode.dynamics,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            **self.facts(),
            "wall_seconds": float(self.wall_seconds),
            **({} if self.cpu_seconds is None else {"cpu_seconds": float(self.cpu_seconds)}),
            "block": int(self.block),
            "recorded": bool(self.recorded),
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Attempt:
        """Rebuild an attempt from `to_dict`.

        Raises:
            ValueError: Fields are missing or unknown.
        """
        check_kind("Attempt", data, Mapping)
        facts, rest = split_facts(data)
        try:
            return Attempt(**facts, **rest)
        except TypeError as error:
            raise ValueError(f"Not an attempt: {error}.") from error
