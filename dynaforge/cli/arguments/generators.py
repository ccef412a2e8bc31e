"""Options that set up a generator, for `evaluate` and `collect`."""

from __future__ import annotations

import argparse

from dynaforge.generators.names import SETTINGS
from dynaforge.options.numbers import Number
from dynaforge.options.paths import ExistingPath

MOST_LEAD = 2.0  # seconds; an object that moves at 1 m/s would have crossed the whole reach


def add_policy(parser: argparse.ArgumentParser) -> None:
    """Add --policy and --lead-time."""
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
