"""Options that set up a generator, for `evaluate` and `collect`."""

from __future__ import annotations

import argparse
from typing import cast

from dynaforge.generators.names import FASTEST, LEVELS, SETTINGS, SLOWEST, Speed
from dynaforge.options.numbers import Number, WholeNumber
from dynaforge.options.paths import ExistingPath
from dynaforge.options.refusal import Refused
from dynaforge.options.words import one_of
from dynaforge.sim.checks import quoted
from dynaforge.sim.prescribed import RELEASES

MOST_LEAD = 2.0  # seconds; an object that moves at 1 m/s would have crossed the whole reach


def add_policy(parser: argparse.ArgumentParser) -> None:
    """Add --policy, --lead-time and --source."""
    parser.add_argument(
        "--policy",
        type=ExistingPath("file"),
        help="policy file, for the generator residual; default: the shipped one",
    )
    parser.add_argument(
        "--lead-time",
        type=Number(0.0, MOST_LEAD),
        metavar="SECONDS",
        help="constant-velocity prediction of the planner, for the generator prediction (default: the stored choice)",
    )
    parser.add_argument(
        "--source",
        type=ExistingPath("file"),
        metavar="FILE",
        help="source demonstration for the generator dmp, an episode of a dataset (default: one at rest is recorded)",
    )


def add_replay(parser: argparse.ArgumentParser) -> None:
    """Add --level, --release and --object-speed."""
    parser.add_argument(
        "--level",
        type=WholeNumber(LEVELS[0], LEVELS[-1]),
        help="shape of the object's path, for replay: 1 a constant velocity, 2 a polynomial, 3 segments (default 1)",
    )
    parser.add_argument(
        "--release",
        **one_of("release", RELEASES),
        help="when physics takes over the object, for replay: at its path's end, or at first contact (default end)",
    )
    parser.add_argument(
        "--object-speed",
        type=object_speed,
        metavar="shipped|task|M/S",
        help="cap on the object's speed, for replay: 0.1 m/s as shipped, that of the condition, or a number "
        "(default shipped)",
    )


def object_speed(text: str) -> Speed:
    """Return the cap on the object's speed that a text names."""
    if text in ("shipped", "task"):
        return cast(Speed, text)
    try:
        return Number(SLOWEST, FASTEST)(text)
    except Refused:
        raise Refused(f"is {quoted(text)}; it must be shipped, task, or {SLOWEST:g} to {FASTEST:g} m/s.") from None


def check_generators(options: argparse.Namespace) -> None:
    """Refuse a setting that none of the chosen generators uses."""
    chosen = [options.generator] if isinstance(options.generator, str) else options.generator
    for name, users in SETTINGS.items():
        value = getattr(options, name, None)
        if value is not None and not set(users) & set(chosen):
            flag = f"--{name.replace('_', '-')} {value}"
            raise ValueError(
                f"{flag} is for the generator {' or '.join(users)}; --generator is {' '.join(chosen) or 'not given'}."
            )
