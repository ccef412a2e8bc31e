"""A command: its arguments, their check, and the module that runs it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.options.parser import Parser


def _do_nothing(_: argparse.ArgumentParser | argparse.Namespace) -> None:
    """Add no argument, or find no mistake."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A command of ours, as opposed to rl_zoo3's.

    Attributes:
        text: What it does, in one line.
        examples: Example command lines for its help, without "dynaforge".
        add: Adds its arguments to a parser.
        check: Checks the options together.
        default_out: Returns the default of --out, which is then checked as if it had been given.
        module: The module of `dynaforge.cli` whose `run` does the work; "" if it has the name of the command.
    """

    text: str
    examples: tuple[str, ...]
    add: Callable[[argparse.ArgumentParser], None] = _do_nothing
    check: Callable[[argparse.Namespace], None] = _do_nothing
    default_out: Callable[[argparse.Namespace], str | Path] | None = None
    module: str = ""

    def parser(self, name: str) -> Parser:
        """Return the parser of its arguments."""
        examples = [f"dynaforge {line}" for line in self.examples]
        parser = Parser(prog=f"dynaforge {name}", description=f"{self.text}.", examples=examples)
        self.add(parser)
        return parser

    def read(self, name: str, arguments: Sequence[str]) -> argparse.Namespace:
        """Return the options that the arguments mean, checked one by one and together.

        Raises:
            ValueError: An option is wrong, or options contradict each other; the message names the option.
        """
        parser = self.parser(name)
        options: argparse.Namespace = parser.parse_args(arguments)
        if "task" in options:
            chosen_tasks(options)
        if "folder" in options:
            open_dataset(options)
        self.check(options)
        if self.default_out is not None and options.out is None:
            options.out = parser.parse_args([f"--out={self.default_out(options)}", *arguments]).out
        return options
