"""Options that read info["is_success"], and what is said when an env does not report it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dynaforge.algos.group_results import GroupResults
from dynaforge.sampling.dispatch import FinishedEpisode


@dataclass(frozen=True)
class SuccessReader:
    """An option value that needs the env's success signal.

    Attributes:
        option: Name of the option.
        value: Its value.
        alternatives: Values that do without, as quoted in messages.
    """

    option: str
    value: str
    alternatives: str

    def __str__(self) -> str:
        return f"{self.option}={self.value!r}"


_READERS = (
    SuccessReader("group_filter", "mixed_success", "'mixed_return' or 'none'"),
    SuccessReader("group_filter", "margin", "'mixed_return' or 'none'"),
    SuccessReader("stratum_weights", "frontier", "'equal'"),
    SuccessReader("scale_advantage", "learnability", "'group'"),
    SuccessReader("scale_learning_rate", "failures", "'none'"),
)


def success_readers(model: Any) -> list[SuccessReader]:
    """Return those options of a FrontierGRPO model that read success."""
    return [reader for reader in _READERS if getattr(model, reader.option) == reader.value]


def require_success(episode: FinishedEpisode, readers: Sequence[SuccessReader]) -> None:
    """Refuse options that read success when an episode ends by itself and does not report it.

    Raises:
        ValueError: Names the option and the remedy.
    """
    if episode.success is not None or episode.truncated:
        return
    for reader in readers:
        raise ValueError(
            f"{reader} reads info['is_success'] at the end of an episode, and this env does not give it. Report it "
            f"there, or use {reader.option}={reader.alternatives}."
        )


def warn_of_unknown_success(results: GroupResults, readers: Sequence[SuccessReader]) -> None:
    """Warn when every episode of an iteration was cut off before its env reported success or failure."""
    if results.success is not None:
        return
    for reader in readers:
        warnings.warn(
            f"{reader} reads info['is_success'], and every episode was cut off before the env gave it: all count as "
            f"failures. Allow longer episodes, or use {reader.option}={reader.alternatives}.",
            stacklevel=3,
        )
