"""One phase of a task's program."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import Any

from dynaforge.sim.checks import check_callable, check_choice, check_flag, check_number, check_text, quoted
from dynaforge.sim.robot import HAND_WIDTH
from dynaforge.tasks.predicates import Predicate
from dynaforge.tasks.predicates.logic import PREDICATE_EXAMPLE
from dynaforge.tasks.targets import Target

Ending = tuple[str, Predicate]


class Mode(StrEnum):
    """How a phase plans: one global trajectory at its entry, or object-centric IK at every control step."""

    GLOBAL = "global"
    IK = "ik"


@dataclass(frozen=True, slots=True)
class Phase:
    """One phase of the program.

    Attributes:
        name: Its name in records and reports.
        mode: Low-frequency global planning or high-frequency IK.
        target: Object-centric target of Eq. 3.
        width: Commanded opening between the fingers, metres.
        done: Success predicate; the phase advances once it held for `hold` seconds.
        timeout: Seconds after which the episode fails.
        failure: The reason recorded then.
        gate: The residual gate m of Eq. 5.
        hold: Seconds from the first to the last of the control steps at which `done` held without a break.
        track_until: Once this holds, the target freezes: the hand must not chase what it pushes.
        takes_hold: At its end the object in the hand is measured: the tool frame of targets that come after.
        residual_share: Share of the task's residual scales that the residual has in this phase.
        fails: (reason, predicate) pairs that end the episode at once while this phase runs.
    """

    name: str
    mode: Mode
    target: Target
    _: KW_ONLY
    width: float
    done: Predicate
    timeout: float
    failure: str
    gate: bool = False
    hold: float = 0.0
    track_until: Predicate | None = None
    takes_hold: bool = False
    residual_share: float = 1.0
    fails: tuple[Ending, ...] = ()

    def __post_init__(self) -> None:
        check_text("Phase: name", self.name)
        what = f"Phase {self.name!r}"
        check_choice(f"{what}: mode", self.mode, tuple(Mode))
        object.__setattr__(self, "mode", Mode(self.mode))
        check_callable(f"{what}: target", self.target, such_as='a target, such as Above("can", 0.1)')
        check_callable(f"{what}: done", self.done, such_as=PREDICATE_EXAMPLE)
        check_number(f"{what}: width", self.width, least=0.0, most=HAND_WIDTH)
        check_number(f"{what}: timeout", self.timeout, above=0.0)
        check_number(f"{what}: hold", self.hold, least=0.0)
        check_text(f"{what}: failure", self.failure)
        for name in ("gate", "takes_hold"):
            check_flag(f"{what}: {name}", getattr(self, name))
        check_number(f"{what}: residual_share", self.residual_share, above=0.0, most=1.0)
        object.__setattr__(self, "fails", endings_of(f"{what}: fails", self.fails))
        if self.hold >= self.timeout:
            raise ValueError(
                f"{what}: hold {self.hold:g} s is not below its timeout {self.timeout:g} s, so it can never be done."
            )
        if self.track_until is not None:
            check_callable(f"{what}: track_until", self.track_until, such_as=PREDICATE_EXAMPLE)
        for name, given in (("gate", self.gate), ("track_until", self.track_until)):
            if given and self.mode is Mode.GLOBAL:
                raise ValueError(
                    f"{what}: {name} has no effect in Mode.GLOBAL, where the hand follows one trajectory planned at "
                    f"the phase's entry; leave {name} out, or let the phase track with Mode.IK."
                )

    def is_held(self, samples: int, control_dt: float) -> bool:
        """Tell whether `done`, true at the last `samples` control steps of `control_dt` seconds, held long enough."""
        return samples > 0 and (samples - 1) * control_dt >= self.hold - 1e-9


def endings_of(what: str, given: Any) -> tuple[Ending, ...]:
    """Return (reason, predicate) pairs as they are; refuse anything else."""
    if not isinstance(given, (tuple, list)) or not all(isinstance(e, (tuple, list)) and len(e) == 2 for e in given):
        raise ValueError(f'{what} is {quoted(given)}; it must be a tuple of pairs: (("dropped", Fallen("can")),).')
    for reason, predicate in given:
        check_text(f"{what}: a reason", reason)
        check_callable(f"{what}: the predicate of {reason!r}", predicate, such_as=PREDICATE_EXAMPLE)
    return tuple(given)
