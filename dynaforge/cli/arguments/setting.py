"""The arguments that choose the setting of a task."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any, cast

from dynaforge.options.refusal import Refused
from dynaforge.options.words import Choice, one_of
from dynaforge.sim.checks import quoted
from dynaforge.sim.reflex import REFLEX_NAMES, thresholds
from dynaforge.sim.setting import PHYSICS, SENSINGS, Reflex, Setting


def add_setting(parser: argparse.ArgumentParser) -> None:
    """Add --reflex, --physics and --sensing."""
    parser.add_argument(
        "--reflex",
        type=reflex,
        metavar="NAME|NEWTONS",
        help=f"external force that stops the robot: {', '.join(REFLEX_NAMES)}, or newtons (default: the task's own, "
        "contact)",
    )
    parser.add_argument(
        "--physics",
        type=Choice("physics", PHYSICS),
        metavar="{fixed,varied,wide,wide:FIELD,fine}",
        help="how far friction, masses, gains and the hand's dead time vary between conditions; with wide:hand_delay, "
        "say, only that one is wide; fine is varied in physics steps of half the length (default: the task's, varied)",
    )
    parser.add_argument(
        "--sensing",
        **one_of("sensing", SENSINGS),
        help="what planner and policy see: the truth, or late and blurred (default: the task's, ideal)",
    )


def reflex(text: str) -> Reflex:
    """Return the reflex that a text names: a named threshold, or newtons.

    Raises:
        argparse.ArgumentTypeError: It names none.
    """
    try:
        value: Any = text if text in REFLEX_NAMES else float(text)
        thresholds(value)
    except ValueError:
        known = ", ".join(REFLEX_NAMES)
        raise Refused(f"is {quoted(text)}; it must be {known}, or a number of newtons above 0.") from None
    return cast(Reflex, value)


def chosen_parts(options: argparse.Namespace) -> tuple[str, ...]:
    """Return the parts of the setting that were asked for by flags."""
    return tuple(name for name in Setting.__slots__ if getattr(options, name, None) is not None)


def setting_lines(settings: Iterable[tuple[str, str]]) -> list[str]:
    """Return a line for each setting, with the names of all that have it: "can, peach: reflex contact, ...".

    Args:
        settings: Names, each with its setting in words.
    """
    names: dict[str, dict[str, None]] = {}  # without repetition, in order
    for name, setting in settings:
        names.setdefault(setting, {})[name] = None
    return [f"{', '.join(found)}: {setting}" for setting, found in names.items()]
