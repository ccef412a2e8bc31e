"""Which episodes an update consists of: N conditions, each run K times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np


class ConditionSampler(Protocol):
    """What an env offers so that its episodes can be drawn and repeated. Must be picklable."""

    def draw(self, rng: np.random.Generator, stratum: int | None = None, n_strata: int = 1) -> Any:
        """Draw a condition from one of `n_strata` strata of difficulty, or from the whole range when None."""

    def reset_kwargs(self, condition: Any) -> dict[str, Any]:
        """Return what `env.reset` takes to run this condition."""


@dataclass(frozen=True, slots=True)
class SeedConditionSampler:
    """Conditions for envs that know none: a condition is a reset seed, shared by the rollouts of a group.

    Seeds have no order of difficulty, so strata mean nothing here and are ignored.
    """

    def draw(self, rng: np.random.Generator, stratum: int | None = None, n_strata: int = 1) -> int:
        """Draw a reset seed."""
        return int(rng.integers(2**31 - 1))

    def reset_kwargs(self, condition: Any) -> dict[str, Any]:
        """Return the seed as `env.reset` takes it."""
        return {"seed": condition}


@dataclass(frozen=True, slots=True)
class Job:
    """One episode to run.

    Attributes:
        index: Position among the jobs of an update, group * K + rollout.
        group: Which condition.
        rollout: Which of its K repetitions.
        stratum: Stratum of difficulty the condition was drawn from; None for the whole range.
        reset_kwargs: What `env.reset` takes.
    """

    index: int
    group: int
    rollout: int
    stratum: int | None
    reset_kwargs: Mapping[str, Any]

    def __str__(self) -> str:
        options = self.reset_kwargs.get("options") or {}
        condition = getattr(options.get("condition"), "id", None)
        what = f"condition {condition}" if condition else f"reset({_spell(self.reset_kwargs)})"
        return f"rollout {self.rollout} of group {self.group}, {what}"


@dataclass(frozen=True, slots=True)
class Group:
    """One condition and the stratum it was drawn from; its rollouts share all of it."""

    index: int
    stratum: int | None
    condition: Any
    reset_kwargs: Mapping[str, Any] = field(repr=False)


class StratifiedSampler:
    """Draws the conditions of an update and spells them out as jobs.

    "Stratified matched-condition groups" of the paper: one condition from each of N strata of difficulty, K
    rollouts of each. Which envs run the jobs, and how many there are, plays no part in what is drawn.

    Args:
        n_groups: N, at least 1.
        group_size: K, at least 1 here (an algorithm that compares rollouts needs 2).
        stratified: False draws all N i.i.d. from the whole range (vanilla GRPO).

    Raises:
        ValueError: N or K below 1.
    """

    def __init__(self, n_groups: int, group_size: int, *, stratified: bool = True) -> None:
        if n_groups < 1 or group_size < 1:
            raise ValueError(f"n_groups and group_size must be at least 1; given {n_groups} and {group_size}.")
        self.n_groups = n_groups
        self.group_size = group_size
        self.strata: tuple[int | None, ...] = tuple(range(n_groups)) if stratified else (None,) * n_groups

    def draw(
        self,
        conditions: ConditionSampler,
        rng: np.random.Generator,
        *,
        strata: Sequence[int | None] | None = None,
        first_index: int = 0,
    ) -> list[Group]:
        """Draw one condition for each stratum.

        Args:
            conditions: Where conditions come from.
            rng: Source of all randomness.
            strata: Strata to draw from, default each of the N once; a shorter list draws replacements.
            first_index: Index of the first group.
        """
        groups = []
        for index, stratum in enumerate(self.strata if strata is None else strata, start=first_index):
            condition = conditions.draw(rng, stratum, self.n_groups if stratum is not None else 1)
            groups.append(Group(index, stratum, condition, conditions.reset_kwargs(condition)))
        return groups

    def jobs(self, groups: Sequence[Group]) -> list[Job]:
        """Spell out K jobs a group, in the order to run them: the first rollout of every group, then the second.

        Run group by group, the last episodes of an update would be the hardest, and every trailing mean, such as
        rollout/success_rate, would show the hard strata only. The jobs of a group share one reset_kwargs object.
        """
        return [
            Job(group.index * self.group_size + rollout, group.index, rollout, group.stratum, group.reset_kwargs)
            for rollout in range(self.group_size)
            for group in groups
        ]


def _spell(kwargs: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}={value!r}" for key, value in kwargs.items())
