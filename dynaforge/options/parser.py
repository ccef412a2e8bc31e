"""The parser of a command line: a mistake is reported in one line, and the help has examples."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from dynaforge.sim.checks import close_match, quoted


class Parser(argparse.ArgumentParser):
    """A parser that raises ValueError with one line instead of printing its usage and ending the process.

    Args:
        examples: Command lines at the end of `--help`.
        options: Options of `argparse.ArgumentParser`.
    """

    def __init__(self, *, examples: Sequence[str] = (), **options: Any) -> None:
        epilog = "\n".join(("examples:", *(f"  {line}" for line in examples))) if examples else None
        super().__init__(formatter_class=_Help, epilog=epilog, exit_on_error=False, **options)

    def parse_args(self, arguments: Any = None, namespace: Any = None) -> Any:
        """Return the options that the arguments mean.

        Raises:
            ValueError: An argument is unknown or missing, or has a wrong value; the message names the option.
        """
        try:
            options, unknown = self.parse_known_args(arguments, namespace)
        except argparse.ArgumentError as error:
            joint = "" if error.message.startswith(":") else " "
            raise ValueError(f"{error.argument_name or ''}{joint}{error.message}".strip()) from None
        if unknown:
            given = unknown[0].partition("=")[0]
            hint = close_match(given, self._option_string_actions) or f" `{self.prog} --help` lists them."
            raise ValueError(
                f"No option {quoted(given)}.{hint}" if given[:1] == "-" else f"What is {quoted(given)} for?"
            )
        return options

    def error(self, message: str) -> NoReturn:
        """Raise ValueError with the message."""
        raise ValueError(message)


class Distinct(argparse.Action):
    """Stores the values of an option that takes several values, which must all be different."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Store the values."""
        if repeated := [value for k, value in enumerate(values) if value in values[:k]]:
            raise argparse.ArgumentError(self, f"names {quoted(str(repeated[0]))} twice.")
        setattr(namespace, self.dest, values)


class _Help(argparse.RawDescriptionHelpFormatter):
    """Adds the default of an option to its help text, where the option has one."""

    def _get_help_string(self, action: argparse.Action) -> str:
        default, text = action.default, action.help or ""
        has_none = default is None or default is False or default is argparse.SUPPRESS
        if has_none or "default" in text or not action.option_strings:
            return text
        listed = default if isinstance(default, list | tuple) else [default]
        return f"{text} (default: {' '.join(map(str, listed)).replace('%', '%%')})"
