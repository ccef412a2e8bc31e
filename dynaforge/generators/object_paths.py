"""Paths for an object that end where and when a recorded grasp closes: the trajectories of synchronised replay.

Everything is horizontal; the object keeps its height. Lengths are in metres, times in seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial

from dynaforge.generators.names import SLOWEST, Level
from dynaforge.geometry import Array, one_line

JITTER = 0.1  # of the path's length, by which the points of level 2 are moved on each axis
TURN = math.pi / 3  # rad, by which a segment of level 3 may turn into the next one
TRIES = 100  # draws until a path is accepted; after these, the last one is shortened
SHORTER, SHORTEST = 0.8, 0.01  # a factor, and metres

Pieces = tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Ending:
    """How the path of an object ends.

    Attributes:
        position: Position of its origin, shape (3,).
        direction: The horizontal direction in which it arrives, as an angle in radians from the world's x axis.
        duration: Seconds from the beginning to the end of the path.
    """

    position: Array
    direction: float
    duration: float

    __repr__ = one_line


def draw_speed(rng: np.random.Generator, cap: float) -> float:
    """Draw a speed: |N(0.8 c, (c / 3)^2)|, clipped to [0.01 m/s, c].

    Args:
        rng: Source of randomness.
        cap: The largest speed c, m/s.
    """
    return float(np.clip(abs(rng.normal(0.8 * cap, cap / 3.0)), SLOWEST, cap))


def draw_path(
    rng: np.random.Generator, level: Level, ending: Ending, *, cap: float, is_free: Callable[[Array], bool]
) -> tuple[tuple[float, ...], Pieces]:
    """Draw a path that ends at a place after a given time, at no more than a given speed.

    Level 1 moves at constant velocity. Level 2 follows a polynomial of degree 2 to 4 through three to five points, the
    first and last of which are those of level 1; those between are moved at random. Level 3 has two or three segments
    of equal duration, each at a constant velocity of its own; the last one arrives as in level 1.

    Args:
        rng: Source of randomness.
        level: 1, 2 or 3.
        ending: Where, in which direction and when it ends.
        cap: The largest speed, m/s.
        is_free: Whether the object may be at all of some points, shape (n, 3). A path is drawn again where it may not,
            and in the end shortened.

    Returns:
        Knots and pieces, as `PrescribedMotion` takes them.
    """
    for _ in range(TRIES):
        knots, offsets = (_straight, _curved, _segments)[level - 1](rng, ending, cap)
        if is_free(ending.position + _sampled(knots, offsets)):
            break
    else:
        while not is_free(ending.position + _sampled(knots, offsets)) and np.abs(offsets[0][0]).max() > SHORTEST:
            offsets = [SHORTER * offset for offset in offsets]
    x, y, z = ending.position.tolist()
    return tuple(knots), tuple((_plus(x, offset[:, 0]), _plus(y, offset[:, 1]), (z,)) for offset in offsets)


def top_speed(knots: tuple[float, ...], pieces: Pieces, *, samples: int = 1000) -> float:
    """Return the greatest speed on a path, m/s."""
    greatest = 0.0
    for a, b, piece in zip(knots, knots[1:], pieces, strict=False):
        times = np.linspace(0.0, b - a, samples)
        x, y = (polynomial.polyval(times, polynomial.polyder(np.array(axis))) for axis in piece[:2])
        greatest = max(greatest, float(np.hypot(x, y).max()))
    return greatest


def _straight(rng: np.random.Generator, ending: Ending, cap: float) -> tuple[list[float], list[Array]]:
    velocity = draw_speed(rng, cap) * _unit(ending.direction)
    return [0.0, ending.duration], [np.array((-ending.duration * velocity, velocity))]


def _curved(rng: np.random.Generator, ending: Ending, cap: float) -> tuple[list[float], list[Array]]:
    (_, duration), (line,) = _straight(rng, ending, cap)
    n = int(rng.integers(3, 6))
    times = np.linspace(0.0, duration, n)
    points = line[0] + times[:, None] * line[1]
    points[1:-1] += JITTER * float(np.linalg.norm(line[0])) * rng.uniform(-1.0, 1.0, (n - 2, 2))
    # The offset is t - T times a polynomial, so that it is 0 at the end whatever the rounding.
    share = points[:-1] / (times[:-1] - duration)[:, None]
    rest = np.linalg.solve(np.vander(times[:-1], increasing=True), share)
    curve = np.array([polynomial.polymul((-duration, 1.0), rest[:, axis]) for axis in (0, 1)]).T
    shrink = min(1.0, cap / top_speed((0.0, duration), (tuple(map(tuple, curve.T)),)))
    return [0.0, duration], [shrink * curve]


def _segments(rng: np.random.Generator, ending: Ending, cap: float) -> tuple[list[float], list[Array]]:
    n = int(rng.integers(2, 4))
    knots, each = np.linspace(0.0, ending.duration, n + 1).tolist(), ending.duration / n
    end, direction, offsets = np.zeros(2), ending.direction, []
    for _ in range(n):  # from the last one back to the first
        velocity = draw_speed(rng, cap) * _unit(direction)
        offsets.append(np.array((end - each * velocity, velocity)))
        end, direction = end - each * velocity, direction + rng.uniform(-TURN, TURN)
    return knots, offsets[::-1]


def _unit(angle: float) -> Array:
    return np.array((math.cos(angle), math.sin(angle)))


def _plus(value: float, coefficients: Array) -> tuple[float, ...]:
    first, *rest = coefficients.tolist()
    return (value + first, *rest)


def _sampled(knots: list[float], offsets: list[Array]) -> Array:
    """Return points of a path relative to its end, shape (n, 3)."""
    parts = [
        polynomial.polyval(np.linspace(0.0, b - a, 50), offset).T
        for a, b, offset in zip(knots, knots[1:], offsets, strict=False)
    ]
    points = np.concatenate(parts)
    return np.column_stack((points, np.zeros(len(points))))
