"""One phase of a task's phase program."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import Any

from dynaforge.sim.checks import check_callable, check_choice, check_flag, check_number, check_text, quoted
from dynaforge.sim.robot import HAND_WIDTH
from dynaforge.tasks.predicates import Predicate
from dynaforge.tasks.predicates.logic import PREDICATE_EXAMPLE
from dynaforge.tasks.targets import Target

# m/s: ISO 10218-1's reduced speed. At this speed the arm, about 3 kg at the hand, strikes a stiffness of 12 kN/m with
# about 50 N, half the force at which the robot stops in contact work.
REDUCED_SPEED = 0.25
Ending = tuple[str, Predicate]
Retry = tuple[str, Predicate]


class Mode(StrEnum):
    """How a phase plans: one global trajectory at its entry, or object-centric IK at every control step."""

    GLOBAL = "global"
    IK = "ik"


@dataclass(frozen=True, slots=True)
class Phase:
    """One phase of the program.

    Attributes:
        name: Name in recordings and reports.
        mode: Low-frequency global planning or high-frequency IK.
        target: Object-centric target of Eq. 3.
        width: Commanded opening between the fingers, metres.
        done: Success predicate; the phase ends once it has held for `hold` seconds.
        timeout: Seconds after which the episode fails; all visits of a phase together may last so long.
        failure: The reason recorded for a timeout.
        gate: The residual gate m of Eq. 5.
        hold: Seconds from the first to the last of the consecutive control steps at which `done` must hold.
        ramp: Speed in m/s at which the target goes from where the phase before has it to where this phase wants it. The
            difference between the two at entry, turned with the heading of the object, shrinks by this speed, so that
            the hand keeps following the object meanwhile; `done` still refers to the target where it ends. None: it
            jumps. Eq. 3 has no ramp; it is our deviation, because a jump of the target in height slows the chase of a
            moving object (all joints arrive together), and because the speed bounds how hard the hand strikes what
            lies below. For the same reason a target below the hand waits for a hand that trails.
        lowest: Least height of the end effector above the origin of the target's object, metres, whatever target and
            residual ask for; what lies below (the object under the palm, 39 mm above the end effector; the pad under
            the fingertips, 7 mm below it) is thus never pressed by command. None: only the table bounds it.
        track_until: Once this holds, the target freezes, so that the hand does not chase what it pushes.
        takes_hold: Whether the pose of the grasped object in the hand is measured at the end of the phase, as the tool
            frame of later targets.
        residual_share: Factor on the task's residual scales in this phase.
        retry: (name of an earlier phase, predicate): when the predicate holds while this phase runs, the program goes
            back to that phase. The time spent in each phase counts on, so that timeouts end every episode, and a
            checkpoint that was passed stays passed.
        fails: (reason, predicate) pairs; while this phase runs, the episode fails as soon as one of them holds.

    Raises:
        ValueError: A field of the wrong type or out of range, a `hold` that the timeout does not allow, or a field that
            has no effect in `Mode.GLOBAL`.
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
    ramp: float | None = None
    lowest: float | None = None
    track_until: Predicate | None = None
    takes_hold: bool = False
    residual_share: float = 1.0
    retry: Retry | None = None
    fails: tuple[Ending, ...] = ()

    def __post_init__(self) -> None:
        check_text("Phase: name", self.name)
        place = f"Phase {self.name!r}"
        check_choice(f"{place}: mode", self.mode, tuple(Mode))
        object.__setattr__(self, "mode", Mode(self.mode))
        check_callable(f"{place}: target", self.target, expected='a target, such as Above("can", 0.1)')
        check_callable(f"{place}: done", self.done, expected=PREDICATE_EXAMPLE)
        check_number(f"{place}: width", self.width, least=0.0, most=HAND_WIDTH)
        check_number(f"{place}: timeout", self.timeout, above=0.0)
        check_number(f"{place}: hold", self.hold, least=0.0)
        check_text(f"{place}: failure", self.failure)
        for name in ("gate", "takes_hold"):
            check_flag(f"{place}: {name}", getattr(self, name))
        check_number(f"{place}: residual_share", self.residual_share, above=0.0, most=1.0)
        object.__setattr__(self, "fails", check_endings(f"{place}: fails", self.fails))
        if self.hold >= self.timeout:
            raise ValueError(
                f"{place}: hold {self.hold:g} s is not below its timeout {self.timeout:g} s, so it can never be done."
            )
        if self.track_until is not None:
            check_callable(f"{place}: track_until", self.track_until, expected=PREDICATE_EXAMPLE)
        if self.ramp is not None:
            check_number(f"{place}: ramp", self.ramp, above=0.0)
        if self.lowest is not None:
            check_number(f"{place}: lowest", self.lowest)
        if self.retry is not None:
            _check_retry(f"{place}: retry", self.retry)
            object.__setattr__(self, "retry", tuple(self.retry))
        for name, value in (("gate", self.gate), ("ramp", self.ramp), ("track_until", self.track_until)):
            if value and self.mode is Mode.GLOBAL:
                raise ValueError(
                    f"{place}: {name} has no effect in Mode.GLOBAL, where the hand follows one trajectory planned at "
                    f"the phase's entry; leave {name} out, or let the phase track with Mode.IK."
                )

    def is_held(self, samples: int, control_dt: float) -> bool:
        """Return whether `done` has held for long enough.

        Args:
            samples: Consecutive control steps up to now at which it was true.
            control_dt: Duration of a control step, seconds.
        """
        return samples > 0 and (samples - 1) * control_dt >= self.hold - 1e-9


def _check_retry(what: str, value: Any) -> None:
    """Raise ValueError unless the value is a pair of a name and a predicate."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ValueError(
            f'{what} is {quoted(value)}; it must be a pair of an earlier phase and a predicate: ("track", Missed()).'
        )
    check_text(f"{what}: the phase", value[0])
    check_callable(f"{what}: the predicate", value[1], expected=PREDICATE_EXAMPLE)


def check_endings(what: str, value: Any) -> tuple[Ending, ...]:
    """Return the value, a tuple or list of (reason, predicate) pairs, as a tuple; raise ValueError otherwise."""
    if not isinstance(value, (tuple, list)) or not all(isinstance(e, (tuple, list)) and len(e) == 2 for e in value):
        raise ValueError(f'{what} is {quoted(value)}; it must be a tuple of pairs: (("dropped", Fallen("can")),).')
    for reason, predicate in value:
        check_text(f"{what}: a reason", reason)
        check_callable(f"{what}: the predicate of {reason!r}", predicate, expected=PREDICATE_EXAMPLE)
    return tuple(value)
