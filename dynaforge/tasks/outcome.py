"""How an episode ended: one value that travels from the executor to files, infos and tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dynaforge.sim.checks import check_flag, check_kind, check_whole

STORED = ("success", "checkpoint", "failure", "phase")
"""The entries of an outcome in files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How an episode ended.

    Attributes:
        success: y of Eq. 6.
        checkpoint: c of Eq. 6: number of phases completed in order; C on success, less otherwise.
        n_checkpoints: C of Eq. 6; None if the outcome was read from a file or an info, which do not contain it. It is a
            property of the task, so it is neither compared nor printed.
        failure: The reason in a few words, the same words for the same cause; "" on success.
        phase: Name of the phase in which the episode ended; "" if no phase program ran.

    Raises:
        ValueError: A field of the wrong type or out of range, a success with a reason, or a failure without one.
    """

    success: bool
    checkpoint: int
    n_checkpoints: int | None = field(default=None, compare=False, repr=False)
    failure: str = ""
    phase: str = ""

    def __post_init__(self) -> None:
        check_flag("Outcome: success", self.success)
        check_whole("Outcome: checkpoint", self.checkpoint, least=0)
        check_kind("Outcome: failure", self.failure, str)
        check_kind("Outcome: phase", self.phase, str)
        if self.success and self.failure:
            raise ValueError(f"A success has no failure reason, but {self.failure!r} was given.")
        if not self.success and not self.failure:
            raise ValueError("A failure needs a reason, e.g. 'timeout'.")
        if self.n_checkpoints is not None:
            self._check_against_all(self.n_checkpoints)
        object.__setattr__(self, "success", bool(self.success))  # numpy's own types cannot be written as JSON
        object.__setattr__(self, "checkpoint", int(self.checkpoint))

    def _check_against_all(self, n_checkpoints: int) -> None:
        check_whole("Outcome: n_checkpoints", n_checkpoints, least=1)
        if self.checkpoint > n_checkpoints or self.success != (self.checkpoint == n_checkpoints):
            raise ValueError(
                f"Outcome: success is {self.success} at checkpoint {self.checkpoint} of n_checkpoints={n_checkpoints}; "
                "success means having reached the last one."
            )

    def __str__(self) -> str:
        return "success" if self.success else self.failure

    def episodic_return(self) -> float:
        """Return R of Eq. 6: 1 on success, otherwise the share of checkpoints passed.

        Raises:
            ValueError: It is a failure that was read from a file or an info, so that C is not known.
        """
        if self.success:
            return 1.0
        if self.n_checkpoints is None:
            raise ValueError(f"The return of a failure needs n_checkpoints, which {self!r} does not contain.")
        return self.checkpoint / self.n_checkpoints

    def to_dict(self) -> dict[str, Any]:
        """Return the entries that files contain, as plain JSON data."""
        return {name: getattr(self, name) for name in STORED}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Outcome:
        """Return the outcome that `to_dict` was called on; further entries are ignored.

        Raises:
            ValueError: An entry is missing or malformed.
        """
        check_kind("Outcome", data, Mapping)
        if missing := [name for name in STORED if name not in data]:
            raise ValueError(f"Outcome lacks {missing}.")
        return Outcome(**{name: data[name] for name in STORED})

    def as_info(self) -> dict[str, Any]:
        """Return the entries of an env's info; checkpoint and phase are absent if no phase program ran."""
        info: dict[str, Any] = {"is_success": self.success, "failure": self.failure}
        if self.phase:
            info |= {"checkpoint": self.checkpoint, "phase": self.phase}
        return info

    @staticmethod
    def of_info(info: Mapping[str, Any]) -> Outcome | None:
        """Return the outcome in an env's info, or None if the step did not end the episode.

        If no phase program ran, the checkpoint is 0.
        """
        if "failure" not in info:
            return None
        return Outcome(
            success=info["is_success"],
            checkpoint=info.get("checkpoint", 0),
            failure=info["failure"],
            phase=info.get("phase", ""),
        )
