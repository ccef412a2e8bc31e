"""Motion of an object that is prescribed instead of simulated: what one generator does, and no task can."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from dynaforge.geometry import Pose, one_line
from dynaforge.sim.checks import check_choice, check_kind, check_number, check_numbers, check_text, check_tuple
from dynaforge.sim.starts import Drive, Launch, Placement

Release = Literal["end", "contact"]
"""When physics takes over: at the end of the path, at rest; or as soon as the robot touches the body, as it moves."""
RELEASES: tuple[Release, ...] = get_args(Release)
DEGREE = 5  # of a piece at most
JUMP = 1e-6  # metres by which pieces may miss each other, and the last one the end, by rounding


@dataclass(frozen=True, slots=True, kw_only=True)
class PrescribedMotion:
    """A path along which one free body is driven from t = 0 on, with constant orientation; afterwards physics moves it.

    Attributes:
        body: Name of the body.
        quat_wxyz: Its orientation, a unit quaternion.
        end: Where the path ends: position of its origin, metres.
        knots: Times at which the pieces of the path begin, from 0, and the last one's end, seconds; (0,) for a body
            that stands at `end` from the beginning and is not driven.
        pieces: For each piece three polynomials, x, y and z: coefficients in metres of 1, t, t^2, ... where t are the
            seconds since the piece began.
        release: When physics takes over, as in `Release`.
        still: Names of the fixtures that stand still where the condition starts them.

    Raises:
        ValueError: A field is of the wrong type, or the path has a gap or does not end at `end`.
    """

    body: str
    quat_wxyz: tuple[float, ...]
    end: tuple[float, ...]
    knots: tuple[float, ...] = (0.0,)
    pieces: tuple[tuple[tuple[float, ...], ...], ...] = ()
    release: Release = "end"
    still: tuple[str, ...] = ()

    __repr__ = one_line

    def __post_init__(self) -> None:
        place = "PrescribedMotion"
        check_text(f"{place}: body", self.body)
        check_numbers(f"{place}: quat_wxyz", self.quat_wxyz, 4)
        check_numbers(f"{place}: end", self.end, 3)
        check_choice(f"{place}: release", self.release, RELEASES)
        check_tuple(f"{place}: still", self.still, str)
        if abs(math.hypot(*self.quat_wxyz) - 1.0) > JUMP:
            raise ValueError(f"{place}: quat_wxyz {self.quat_wxyz} is no unit quaternion.")
        check_tuple(f"{place}: pieces", self.pieces, tuple)
        check_numbers(f"{place}: knots", self.knots, len(self.pieces) + 1)
        if self.knots[0] != 0.0 or any(a >= b for a, b in zip(self.knots, self.knots[1:], strict=False)):
            raise ValueError(f"{place}: knots are {self.knots}; they must begin with 0 and increase.")
        for piece in self.pieces:
            if len(piece) != 3 or not all(isinstance(axis, tuple) and 0 < len(axis) <= DEGREE + 1 for axis in piece):
                raise ValueError(
                    f"{place}: a piece is {piece}; it must be three tuples of 1 to {DEGREE + 1} coefficients."
                )
            for coefficient in (value for axis in piece for value in axis):
                check_number(f"{place}: a coefficient", coefficient)
        for k, knot in enumerate(self.knots[1:]):
            after = self._on_piece(k + 1, 0.0) if k + 1 < len(self.pieces) else self.end
            if math.dist(self._on_piece(k, knot - self.knots[k]), after) > JUMP:
                raise ValueError(
                    f"{place}: the path has a gap at {knot:g} s; each piece begins where the last one ends."
                )

    @property
    def duration(self) -> float:
        """Seconds from the beginning to the end of the path."""
        return self.knots[-1]

    def position(self, time: float) -> tuple[float, ...]:
        """Return where the body's origin is at a time (s), metres; from the end of the path on, exactly `end`."""
        if time >= self.duration:
            return self.end
        k = max(bisect_right(self.knots, time) - 1, 0)
        return self._on_piece(k, time - self.knots[k])

    def _on_piece(self, k: int, t: float) -> tuple[float, ...]:
        return tuple(sum(a * t**n for n, a in enumerate(axis)) for axis in self.pieces[k])

    def velocity(self, time: float, dt: float) -> tuple[float, ...]:
        """Return the velocity that brings the body along the path for `dt` seconds from a time on, m/s."""
        here, there = self.position(time), self.position(time + dt)
        return tuple((b - a) / dt for a, b in zip(here, there, strict=True))

    def starts(self, starts: Mapping[str, Launch | Placement]) -> dict[str, Launch | Placement]:
        """Return the starts of a scene with this body at the beginning of its path, at rest, and still fixtures.

        Args:
            starts: Those of the condition, as `SceneSpec.starts` returns them.

        Raises:
            ValueError: A name is not in the scene, or is not that of a free body, or of a fixture.
        """
        changed = dict(starts)
        launch = starts.get(self.body)
        check_kind(f"PrescribedMotion: the start of {self.body!r}", launch, Launch)
        assert isinstance(launch, Launch)
        pose, nothing = Pose.from_quat(self.position(0.0), self.quat_wxyz), np.zeros(3)
        changed[self.body] = Launch(pose, nothing, nothing, launch.mass)
        for name in self.still:
            fixture = starts.get(name)
            check_kind(f"PrescribedMotion: the start of {name!r}", fixture, Placement)
            assert isinstance(fixture, Placement)
            changed[name] = replace(fixture, drives={j: Drive(start=d.start) for j, d in fixture.drives.items()})
        return changed

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that JSON stores without loss."""
        return {
            "body": self.body,
            "quat_wxyz": list(self.quat_wxyz),
            "end": list(self.end),
            "knots": list(self.knots),
            "pieces": [[list(axis) for axis in piece] for piece in self.pieces],
            "release": self.release,
            "still": list(self.still),
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> PrescribedMotion:
        """Rebuild a motion from `to_dict`.

        Raises:
            ValueError: A field is missing, unknown or malformed.
        """
        check_kind("PrescribedMotion", data, Mapping)
        try:
            return PrescribedMotion(**{name: _tuples(value) for name, value in data.items()})
        except TypeError as error:
            raise ValueError(f"Not a prescribed motion: {error}.") from error


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
