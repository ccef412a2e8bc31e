"""Episodes in which the motion of an object is prescribed, and how they say so."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dynaforge.sim.checks import check_kind, check_number
from dynaforge.sim.prescribed import PrescribedMotion

if TYPE_CHECKING:
    from dynaforge.demos.episode import Episode

FREE, PRESCRIBED = "free", "prescribed"
"""What moves the objects of an episode: only physics, or for a while a prescribed path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prescription:
    """What an episode notes on its prescribed motion.

    Attributes:
        options: The options of the generator that made it.
        motion: The path of the object.
        until: Seconds from the reset for which the object was driven along it.
    """

    options: Mapping[str, Any]
    motion: PrescribedMotion
    until: float


def prescription_of(episode: Episode) -> Prescription | None:
    """Return what an episode notes on its prescribed motion; None where only physics moves its objects.

    Raises:
        ValueError: The notes are malformed.
    """
    if episode.dynamics == FREE:
        return None
    notes = episode.meta.get("prescribed")
    check_kind("its note on the prescribed motion", notes, Mapping)
    assert notes is not None
    check_kind("the options of its prescribed motion", notes.get("options"), Mapping)
    check_number("the end of its prescribed motion", notes.get("until"), least=0.0)
    motion = PrescribedMotion.from_dict(notes.get("motion"))
    return Prescription(options=notes["options"], motion=motion, until=float(notes["until"]))


def describe_dynamics(dynamics: Iterable[str]) -> str:
    """Return in one sentence how many of some episodes have a prescribed motion; "" if none has.

    Args:
        dynamics: `dynamics` of each episode or attempt.
    """
    every = list(dynamics)
    n = sum(each == PRESCRIBED for each in every)
    if not n:
        return ""
    return (
        f"prescribed in {n} of {len(every)}: there, a path that was drawn beforehand moves the object until it is "
        "grasped, not physics, and nothing that touches it changes its motion"
    )


def motion_of(episode: Episode) -> PrescribedMotion | None:
    """Return the path that is prescribed to an object of an episode; None where there is none.

    Raises:
        ValueError: The notes are malformed.
    """
    prescription = prescription_of(episode)
    return None if prescription is None else prescription.motion
