"""What a predicate is, and predicates made of others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from dynaforge.geometry import Pose
from dynaforge.sim.checks import check_callable, quoted
from dynaforge.tasks.view import PhaseView

PREDICATE_EXAMPLE = 'a predicate, such as Grasped("can")'


class Predicate(Protocol):
    """A condition on the view, given the phase's current target `T_world_ee`."""

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        """Return whether it holds now."""
        ...


@dataclass(frozen=True, slots=True)
class All:
    """All of `parts` hold."""

    parts: tuple[Predicate, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.parts, (tuple, list)) or not self.parts:
            raise ValueError(
                f"All: parts is {quoted(self.parts)}; it must be a tuple of predicates: All((Reached(0.03),))."
            )
        for part in self.parts:
            check_callable("All: one of parts", part, expected=PREDICATE_EXAMPLE)
        object.__setattr__(self, "parts", tuple(self.parts))

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return all(part(view, target) for part in self.parts)


@dataclass(frozen=True, slots=True)
class Not:
    """`part` does not hold."""

    part: Predicate

    def __post_init__(self) -> None:
        check_callable("Not: part", self.part, expected=PREDICATE_EXAMPLE)

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        return not self.part(view, target)
