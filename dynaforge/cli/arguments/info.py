"""The arguments of `dynaforge info`."""

from __future__ import annotations

from dynaforge.cli.arguments.datasets import add_dataset_arguments
from dynaforge.cli.command import Command

COMMAND = Command(
    text="what a folder of demonstrations contains: rates, lengths, ranges, size",
    examples=("info data/can",),
    add=add_dataset_arguments,
)
