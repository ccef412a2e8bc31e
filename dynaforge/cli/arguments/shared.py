"""Options with the same meaning in several commands."""

from __future__ import annotations

import argparse

from dynaforge.options.numbers import WholeNumber
from dynaforge.options.paths import ExistingPath
from dynaforge.options.words import one_of
from dynaforge.sampling.processes import usable_cores
from dynaforge.tasks import STREAMS

MOST_WORKERS = 1000
ENGINES = ("local", "ray")


def add_workers(
    parser: argparse.ArgumentParser, meaning: str = "processes", cores: str = "that this process may use"
) -> None:
    """Add --workers.

    Args:
        parser: Parser of the command.
        meaning: What it is the number of.
        cores: Which cores are counted for the default.
    """
    parser.add_argument(
        "--workers",
        type=WholeNumber(1, MOST_WORKERS),
        default=usable_cores(),
        help=f"{meaning}; by default one per core {cores}",
    )


def add_engine(parser: argparse.ArgumentParser, workers: str = "processes, or actors of the engine ray") -> None:
    """Add --engine, and --workers for it; by default each engine knows how many cores it has.

    Args:
        parser: Parser of the command.
        workers: What --workers is the number of.
    """
    add_workers(parser, workers, "that this process may use, or of the cluster")
    parser.set_defaults(workers=None)
    parser.add_argument(
        "--engine",
        **one_of("engine", ENGINES),
        default="local",
        help="local: the cores of this machine; ray: those of a running Ray cluster, with the same results",
    )


def add_stream(parser: argparse.ArgumentParser, default: str) -> None:
    """Add --stream."""
    parser.add_argument("--stream", **one_of("stream", STREAMS), default=default, help="choose on val, report on test")


def add_observations(parser: argparse.ArgumentParser, text: str) -> None:
    """Add --observations, a folder of rendered observations."""
    folder = ExistingPath("folder", containing="settings.json", complaint="holds no observations")
    parser.add_argument("--observations", type=folder, help=text)
