"""One attempt at a task, successful or not, with everything recorded on the way."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from numpy.typing import NDArray

from dynaforge.demos.schema import check_meta, validate_steps
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_flag, check_kind, check_number, check_whole, shown

_GENERATOR_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def episode_id(condition: Condition, generator: str) -> str:
    """Name the attempt of a generator at a condition: equal attempts have equal ids, so repeats are harmless.

    Raises:
        ValueError: The generator's name does not fit into a file name.
    """
    check_generator_name(generator)
    return f"{condition.id}-{generator}"


def check_generator_name(name: Any) -> None:
    """Raise ValueError unless a generator's name fits into a file name."""
    if not isinstance(name, str) or not _GENERATOR_NAME.fullmatch(name):
        raise ValueError(f"Generator name {shown(name)} must consist of letters, digits, '.', '_' and '-'.")


def check_outcome(kind: str, outcome: Any) -> None:
    """Check what an episode and an attempt share.

    Args:
        kind: "Episode" or "Attempt".
        outcome: The one or the other.

    Raises:
        ValueError: A field of the wrong type or out of range, or not exactly the failures carry a reason.
    """
    check_kind(f"{kind}: condition", outcome.condition, Condition)
    episode_id(outcome.condition, outcome.generator)
    check_flag(f"{kind}: success", outcome.success)
    check_whole(f"{kind}: checkpoint", outcome.checkpoint, least=0)
    check_number(f"{kind}: duration", outcome.duration, least=0.0)
    for name in ("failure", "phase"):
        check_kind(f"{kind}: {name}", getattr(outcome, name), str)
    if outcome.success and outcome.failure:
        raise ValueError(f"A success has no failure reason, but {outcome.failure!r} was given.")
    if not outcome.success and not outcome.failure:
        raise ValueError("A failure needs a reason, e.g. 'timeout'.")


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """One attempt: condition, outcome, and what was recorded at each control step.

    Attributes:
        condition: What fixed the episode.
        generator: Name of what made it, e.g. "planner" or "residual".
        success: Whether the task's success predicate was held.
        checkpoint: Checkpoints reached, 0 to C; C on success.
        failure: Reason in a few words, the same words for the same cause; "" on success.
        phase: Name of the phase it ended in.
        duration: Simulated seconds.
        steps: Arrays with leading dimension T at control rate; names, shapes, units in `SCHEMA`. Read-only.
        meta: Plain JSON data: `phases` (names by index), `versions`, `policy_hash`, `task_hash`, digests, ...
    """

    condition: Condition
    generator: str
    success: bool
    checkpoint: int
    failure: str
    phase: str
    duration: float
    steps: Mapping[str, NDArray[Any]]
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_outcome("Episode", self)
        check_kind("Episode: steps", self.steps, Mapping)
        check_kind("Episode: meta", self.meta, Mapping)
        try:
            meta = json.loads(json.dumps(dict(self.meta), allow_nan=False))
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"Episode meta must be plain JSON data: {error}.") from error
        object.__setattr__(self, "steps", MappingProxyType(validate_steps(self.steps)))
        object.__setattr__(self, "meta", MappingProxyType(meta))

    def __reduce__(self) -> tuple[Any, ...]:
        outcome = (self.success, self.checkpoint, self.failure, self.phase, self.duration)
        return Episode, (self.condition, self.generator, *outcome, dict(self.steps), dict(self.meta))

    def __len__(self) -> int:
        return len(self.steps["time"]) if self.steps else 0

    def __repr__(self) -> str:
        outcome = "success" if self.success else f"failure {self.failure!r}"
        return f"Episode({self.condition.task}, {self.generator}, {outcome}, {len(self)} steps)"

    @property
    def id(self) -> str:
        """Condition id and generator: also the file's name."""
        return episode_id(self.condition, self.generator)

    def header(self) -> dict[str, Any]:
        """Return everything but the arrays as plain JSON data."""
        return {
            "condition": self.condition.to_dict(),
            "generator": self.generator,
            "success": bool(self.success),
            "checkpoint": int(self.checkpoint),
            "failure": self.failure,
            "phase": self.phase,
            "duration": float(self.duration),
            "meta": dict(self.meta),
        }

    @staticmethod
    def from_header(header: Mapping[str, Any], steps: Mapping[str, NDArray[Any]]) -> Episode:
        """Rebuild an episode from `header` and its arrays.

        Raises:
            ValueError: A field is missing, unknown or of another type, or the arrays do not fit the schema.
        """
        names = ("generator", "success", "checkpoint", "failure", "phase", "duration")
        if missing := [name for name in (*names, "condition", "meta") if name not in header]:
            raise ValueError(f"Episode header lacks {missing}.")
        check_meta(header["meta"])
        fields: dict[str, Any] = {name: header[name] for name in names}
        episode = Episode(Condition.from_dict(header["condition"]), **fields, steps=steps, meta=header["meta"])
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
