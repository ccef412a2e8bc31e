"""What the values of options may be; what is none is refused in one line, and nothing heavy is imported for it.

The message of a type goes on from the option's name, as in "--workers is 0; it must be at least 1.".
"""

from __future__ import annotations

import argparse
import math
import os
import re
import stat
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from dynaforge.algos.options import LARGEST_SEED
from dynaforge.sampling.processes import usable_cores
from dynaforge.sim.checks import close_match, shown

Refused = argparse.ArgumentTypeError

MOST = 10**9  # of anything that is counted; more is a slip of the finger
MOST_WORKERS = 1000
NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]*"  # of what becomes part of a file's name


class Whole:
    """A whole number in ASCII digits, from `minimum` to `maximum`."""

    def __init__(self, minimum: int = 1, maximum: int = MOST) -> None:
        self.minimum, self.maximum = minimum, maximum

    def __call__(self, text: str) -> int:
        """Read it."""
        if not re.fullmatch(r"[+-]?[0-9]+", text):
            raise Refused(f"is {shown(text)}; it must be a whole number of at least {self.minimum}.")
        digits = text.lstrip("+-0") or "0"
        value = int(text) if len(digits) < 30 else MOST**4 * (-1 if text[0] == "-" else 1)
        if value < self.minimum:
            raise Refused(f"is {shorter(text)}; it must be at least {self.minimum}.")
        if value > self.maximum:
            raise Refused(f"is {shorter(text)}; it must be at most {self.maximum}.")
        return value


SEED = Whole(0, LARGEST_SEED)


class Number:
    """A finite number in ASCII digits, from `minimum`, or above `above`, to `maximum`."""

    def __init__(self, minimum: float = -math.inf, maximum: float = math.inf, *, above: float = -math.inf) -> None:
        self.minimum, self.maximum, self.above = minimum, maximum, above

    def __call__(self, text: str) -> float:
        """Read it."""
        if not re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", text) or math.isinf(float(text)):
            raise Refused(f"is {shown(text)}; it must be a finite number.")
        value = float(text)
        if value < self.minimum:
            raise Refused(f"is {shorter(text)}; it must be at least {self.minimum:g}.")
        if value <= self.above:
            raise Refused(f"is {shorter(text)}; it must be more than {self.above:g}.")
        if value > self.maximum:
            raise Refused(f"is {shorter(text)}; it must be at most {self.maximum:g}.")
        return value


class Choice:
    """One of some names; a slip is answered with the closest."""

    def __init__(self, what: str, names: Iterable[str]) -> None:
        self.what, self.names = what, tuple(names)

    def __call__(self, text: str) -> str:
        """Read it."""
        if text not in self.names:
            hint = close_match(text, self.names)
            raise Refused(f": No {self.what} {shown(text)}.{hint} Known are {', '.join(self.names)}.")
        return text


def one_of(what: str, names: Iterable[str]) -> dict[str, Any]:
    """Return what an option takes that has one of a few values, which `--help` lists."""
    listed = tuple(names)
    return {"type": Choice(what, listed), "choices": listed}


class Text:
    """Text of one line that a pattern describes, for what goes into files as it is."""

    def __init__(self, what: str, pattern: str, *, longest: int = 200) -> None:
        self.what, self.pattern, self.longest = what, pattern, longest

    def __call__(self, text: str) -> str:
        """Read it."""
        if len(text) > self.longest or not re.fullmatch(self.pattern, text):
            raise Refused(f"is {shown(text)}; it must be {self.what}.")
        return text


class Existing:
    """A file or a folder that is there and can be read; of a folder, one that holds a file which says what it is."""

    def __init__(self, kind: str, *, holding: str = "", otherwise: str = "") -> None:
        self.kind, self.holding, self.otherwise = kind, holding, otherwise

    def __call__(self, text: str) -> Path:
        """Read it."""
        path, mode = _path(text), _mode(Path(text))
        if mode is None:
            raise Refused(f"{shown_path(text)}: no such {self.kind}.")
        if not (stat.S_ISREG(mode) if self.kind.endswith("file") else stat.S_ISDIR(mode)):
            raise Refused(f"{shown_path(text)} is a {_named(mode)}; it must be a {self.kind}.")
        if not os.access(path, os.R_OK):
            raise Refused(f"{shown_path(text)} cannot be read: no permission.")
        if self.holding and not (path / self.holding).is_file():
            raise Refused(f"{shown_path(text)} {self.otherwise}: it has no {self.holding}.")
        return path


class Written:
    """A file or a folder to write, whose folders above are made where missing. Nothing is made yet.

    Args:
        kind: "file" or "folder".
        holding: A folder that is there must be empty or hold this file.
        new: Nothing may be there yet.
        empty: A folder that is there must be empty.
    """

    def __init__(self, kind: str, *, holding: str = "", new: bool = False, empty: bool = False) -> None:
        self.kind, self.holding, self.new, self.empty = kind, holding, new, empty

    def __call__(self, text: str) -> Path:
        """Read it."""
        path = _path(text)
        if any("\udc80" <= letter <= "\udcff" for letter in text):  # how Python carries bytes that are no text
            raise Refused(f"is {shown(text)}, no text in this locale; choose another, or set LC_ALL=C.UTF-8.")
        if not text.isprintable():
            raise Refused(f"is {shown(text)}; a name with control characters makes no good {self.kind}.")
        mode = _mode(path)
        if mode is not None:
            self._check_what_is_there(path, mode)
        chain = (path, *path.absolute().parents)
        if dangling := [p for p in chain if os.path.islink(p) and _mode(p) is None]:
            raise Refused(f"{text} cannot be made: {dangling[0]} is a link to nothing. Choose another {self.kind}.")
        above = next(p for p in chain if _mode(p) is not None and (p.is_dir() or p != path))
        if not above.is_dir():
            raise Refused(f"{text} cannot be made: {above} is a file. Choose another {self.kind}.")
        if not os.access(above, os.W_OK | os.X_OK):
            raise Refused(f"{text} cannot be made: {above} is not writable. Choose another {self.kind}.")
        return path

    def _check_what_is_there(self, path: Path, mode: int) -> None:
        if self.new:
            raise Refused(f"{path} exists already. Choose another, or remove it.")
        if not (stat.S_ISREG(mode) if self.kind == "file" else stat.S_ISDIR(mode)):
            raise Refused(f"{path} is a {_named(mode)}; it must be a {self.kind}, new or there.")
        if not os.access(path, os.R_OK | os.W_OK):
            raise Refused(f"{path} cannot be changed: no permission. Choose another {self.kind}.")
        if (self.empty or self.holding) and not (self.holding and (path / self.holding).is_file()):
            others = sorted(entry.name for entry in path.iterdir() if not entry.name.startswith("."))
            if others:
                listed = ", ".join(others[:3])
                raise Refused(f"{path} holds other data ({shorter(listed)}). Choose a new or empty folder.")


def shard(text: str) -> tuple[int, int]:
    """Read "I/N", I from 0."""
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    if not found or int(found[1]) >= int(found[2]):
        raise Refused(f"{shown(text)} is no shard; write 0/4, 1/4, 2/4 or 3/4 for a quarter.")
    return int(found[1]), int(found[2])


def minutes(text: str) -> float:
    """Read a span such as "90s", "10m", "1.5h", or a bare number of minutes."""
    units = {"s": 1 / 60, "m": 1.0, "h": 60.0}
    bare, unit = (text[:-1], units[text[-1]]) if text[-1:] in units else (text, 1.0)
    try:
        return Number(above=0, maximum=MOST)(bare) * unit
    except Refused:
        raise Refused(f"{shown(text)} is no span of time; write 90s, 10m or 1.5h.") from None


def add_workers(parser: argparse.ArgumentParser, what: str = "processes") -> None:
    """Add --workers."""
    parser.add_argument(
        "--workers", type=Whole(1, MOST_WORKERS), default=usable_cores(),
        help=f"{what}; by default one a core that this process may use",
    )  # fmt: skip


class Distinct(argparse.Action):
    """Several values that differ."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Store them."""
        if twice := [value for k, value in enumerate(values) if value in values[:k]]:
            raise argparse.ArgumentError(self, f"names {shown(str(twice[0]))} twice.")
        setattr(namespace, self.dest, values)


class Parser(argparse.ArgumentParser):
    """A parser that raises ValueError, in one line, instead of printing its usage and leaving."""

    def __init__(self, *, examples: Sequence[str] = (), **options: Any) -> None:
        epilog = "\n".join(("examples:", *(f"  {line}" for line in examples))) if examples else None
        super().__init__(formatter_class=_Help, epilog=epilog, exit_on_error=False, **options)

    def parse_args(self, arguments: Any = None, namespace: Any = None) -> Any:
        """Read arguments.

        Raises:
            ValueError: They are none; the message names the option.
        """
        try:
            options, unknown = self.parse_known_args(arguments, namespace)
        except argparse.ArgumentError as error:
            joint = "" if error.message.startswith(":") else " "
            raise ValueError(f"{error.argument_name or ''}{joint}{error.message}".strip()) from None
        if unknown:
            given = unknown[0].partition("=")[0]
            hint = close_match(given, self._option_string_actions) or f" `{self.prog} --help` lists them."
            raise ValueError(f"No option {shown(given)}.{hint}" if given[:1] == "-" else f"What is {shown(given)} for?")
        return options

    def error(self, message: str) -> NoReturn:
        """Raise it."""
        raise ValueError(message)


class _Help(argparse.RawDescriptionHelpFormatter):
    """Tells the defaults that say something."""

    def _get_help_string(self, action: argparse.Action) -> str:
        default, text = action.default, action.help or ""
        quiet = default is None or default is False or default is argparse.SUPPRESS
        if quiet or "default" in text or not action.option_strings:
            return text
        listed = default if isinstance(default, list | tuple) else [default]
        return f"{text} (default: {' '.join(map(str, listed)).replace('%', '%%')})"


def shown_path(text: str) -> str:
    """Return a path as a message may name it."""
    return text if text.isprintable() and len(text) < 1000 else shown(text)


def shorter(text: str, longest: int = 60) -> str:
    """Cut what is too long for a line."""
    return text if len(text) <= longest else f"{text[: longest - 10]}...{text[-7:]}"


def _path(text: str) -> Path:
    if not text or "\0" in text:
        raise Refused(f"is {shown(text)}; it must be a path.")
    return Path(text)


def _mode(path: Path) -> int | None:
    """Return what stands at a path; None for nothing."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise Refused(f"{shown_path(str(path))} cannot be used: {error.strerror}.") from error


def _named(mode: int) -> str:
    kinds: tuple[tuple[Callable[[int], bool], str], ...] = ((stat.S_ISREG, "file"), (stat.S_ISDIR, "folder"))
    return next((name for holds, name in kinds if holds(mode)), "device")
