"""Options that set up a generator, for `evaluate` and `collect`."""

from __future__ import annotations

import argparse

from dynaforge.generators.names import SETTINGS
from dynaforge.options.paths import ExistingPath


def add_policy(parser: argparse.ArgumentParser) -> None:
    """Add --policy."""
    parser.add_argument(
        "--policy",
        type=ExistingPath("file"),
        help="policy file, for the generator residual; default: the shipped one",
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
