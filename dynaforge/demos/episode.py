"""One attempt at a task, successful or not, with everything recorded on the way."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from dynaforge.demos.schema import check_meta, validate_steps
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_kind, check_number, shown
from dynaforge.tasks import Outcome

if TYPE_CHECKING:
    from dynaforge.demos.ledger import Attempt

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


def check_attempt(kind: str, attempt: Episode | Attempt) -> None:
    """Check what an episode and a line of the ledger share.

    Args:
        kind: "Episode" or "Attempt", for messages.
        attempt: The one or the other.

    Raises:
        ValueError: A field is of the wrong type or out of range.
    """
    check_kind(f"{kind}: condition", attempt.condition, Condition)
    check_generator_name(attempt.generator)
    check_kind(f"{kind}: outcome", attempt.outcome, Outcome)
    check_number(f"{kind}: duration", attempt.duration, least=0.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Episode:
    """One attempt: condition, outcome, and what was recorded at each control step.

    Attributes:
        condition: What fixed the episode.
        generator: Name of what made it, e.g. "planner" or "residual".
        outcome: How it ended.
        duration: Simulated seconds.
        steps: Arrays with leading dimension T at control rate; names, shapes, units in `SCHEMA`. Read-only.
        meta: Plain JSON data: `phases` (names by index), `versions`, `policy_hash`, `task_hash`, digests, ...
    """

    condition: Condition
    generator: str
    outcome: Outcome
    duration: float
    steps: Mapping[str, NDArray[Any]]
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_attempt("Episode", self)
        check_kind("Episode: steps", self.steps, Mapping)
        check_kind("Episode: meta", self.meta, Mapping)
        try:
            meta = json.loads(json.dumps(dict(self.meta), allow_nan=False))
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"Episode meta must be plain JSON data: {error}.") from error
        object.__setattr__(self, "steps", MappingProxyType(validate_steps(self.steps)))
        object.__setattr__(self, "meta", MappingProxyType(meta))

    def __reduce__(self) -> tuple[Any, ...]:
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return partial(Episode, **given | {"steps": dict(self.steps), "meta": dict(self.meta)}), ()

    def __len__(self) -> int:
        return len(self.steps["time"]) if self.steps else 0

    def __repr__(self) -> str:
        outcome = "success" if self.success else f"failure {self.failure!r}"
        return f"Episode({self.condition.task}, {self.generator}, {outcome}, {len(self)} steps)"

    @property
    def id(self) -> str:
        """Condition id and generator: also the file's name."""
        return episode_id(self.condition, self.generator)

    @property
    def success(self) -> bool:
        """Whether the task's success predicate was held."""
        return self.outcome.success

    def header(self) -> dict[str, Any]:
        """Return everything but the arrays as plain JSON data."""
        return {
            "condition": self.condition.to_dict(),
            "generator": self.generator,
            **self.outcome.to_dict(),
            "duration": float(self.duration),
            "meta": dict(self.meta),
        }

    @staticmethod
    def from_header(header: Mapping[str, Any], steps: Mapping[str, NDArray[Any]]) -> Episode:
        """Rebuild an episode from `header` and its arrays.

        Raises:
            ValueError: A field is missing, unknown or of another type, or the arrays do not fit the schema.
        """
        if missing := [name for name in ("condition", "generator", "duration", "meta") if name not in header]:
            raise ValueError(f"Episode header lacks {missing}.")
        check_meta(header["meta"])
        episode = Episode(
            condition=Condition.from_dict(header["condition"]),
            generator=header["generator"],
            outcome=Outcome.from_dict(header),
            duration=header["duration"],
            steps=steps,
            meta=header["meta"],
        )
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
