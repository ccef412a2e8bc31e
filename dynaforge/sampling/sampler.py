"""The episodes of an update: N conditions, each run K times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

if TYPE_CHECKING:  # light to import: workers have no need of Stable-Baselines3
    from stable_baselines3.common.vec_env import VecEnv

GOLDEN = (5**0.5 - 1) / 2  # multiples of it, modulo 1, keep neighbours apart
MAX_QUOTED = 200  # characters of reset arguments quoted in an error


class ConditionSampler(Protocol):
    """Draws conditions of an env and says how to run them. It must be picklable."""

    def draw(self, rng: np.random.Generator, stratum: int | None = None, n_strata: int = 1) -> Any:
        """Draw a condition.

        Args:
            rng: Source of all randomness.
            stratum: Stratum of difficulty to draw from, 0 the easiest; None draws from the whole range.
            n_strata: Number of strata that the range is cut into.
        """

    def reset_kwargs(self, condition: Any) -> dict[str, Any]:
        """Return what `env.reset` takes to run this condition."""


@dataclass(frozen=True, slots=True)
class SeedConditionSampler:
    """Conditions for envs without any of their own: a condition is a reset seed, shared by the rollouts of a group."""

    def draw(self, rng: np.random.Generator, stratum: int | None = None, n_strata: int = 1) -> int:
        """Draw a reset seed.

        Args:
            rng: Source of all randomness.
            stratum: Ignored, since seeds have no order of difficulty.
            n_strata: Ignored.
        """
        return int(rng.integers(2**31 - 1))

    def reset_kwargs(self, condition: Any) -> dict[str, Any]:
        """Return the seed as `env.reset` takes it."""
        return {"seed": condition}


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """A condition that several rollouts share, and with it all that they have in common.

    Attributes:
        index: Position among the groups of an update.
        stratum: Stratum of difficulty that the condition was drawn from; None for the whole range.
        condition: The condition.
        reset_kwargs: What `env.reset` takes to run it.
    """

    index: int
    stratum: int | None
    condition: Any
    reset_kwargs: Mapping[str, Any] = field(repr=False)


@dataclass(frozen=True, slots=True)
class Job:
    """One episode to run.

    Attributes:
        group: Whose condition it runs.
        rollout: Which of the group's rollouts it is, from 0.
    """

    group: Group
    rollout: int

    def __str__(self) -> str:
        return f"rollout {self.rollout} of group {self.group.index}, {describe_reset(self.group.reset_kwargs)}"


def condition_sampler_of(env: VecEnv) -> ConditionSampler:
    """Return the condition sampler that the envs offer, else one of reset seeds."""
    if env.has_attr("condition_sampler"):
        return cast(ConditionSampler, env.get_attr("condition_sampler", indices=[0])[0])
    return SeedConditionSampler()


def describe_reset(reset_kwargs: Mapping[str, Any]) -> str:
    """Describe what a reset with these arguments runs: the condition's id if there is one, else the arguments."""
    condition_id = getattr((reset_kwargs.get("options") or {}).get("condition"), "id", None)
    if condition_id is not None:
        return f"condition {condition_id}"
    given = ", ".join(f"{name}={value!r}" for name, value in reset_kwargs.items() if value is not None)
    return f"reset({given[:MAX_QUOTED]})"


class StratifiedSampler:
    """Draws the conditions of an update and lists its jobs.

    The paper's "stratified matched-condition groups": one condition from each of N strata of difficulty, K rollouts
    of each. What is drawn does not depend on how many envs run the jobs.

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
            conditions: Source of conditions.
            rng: Source of all randomness.
            strata: Strata to draw from; by default each of the N once. A shorter list draws replacements.
            first_index: Index of the first group drawn.
        """
        groups = []
        for index, stratum in enumerate(self.strata if strata is None else strata, start=first_index):
            condition = conditions.draw(rng, stratum, self.n_groups if stratum is not None else 1)
            groups.append(Group(index, stratum, condition, conditions.reset_kwargs(condition)))
        return groups

    def jobs(self, groups: Sequence[Group]) -> list[Job]:
        """List the K jobs of each group in the order to begin them: the first rollout of every group, then the second.

        Where envs are fewer than groups, they keep to the groups that they began with. Run from easy to hard, the last
        episodes of an update would be the hardest, and every trailing mean, such as rollout/success_rate, would show
        the hard strata only; so groups that follow each other are far apart.
        """
        spread = sorted(groups, key=lambda group: group.index * GOLDEN % 1.0)
        return [Job(group, rollout) for rollout in range(self.group_size) for group in spread]
