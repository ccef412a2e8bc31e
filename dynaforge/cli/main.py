"""The `dynaforge` command."""

from __future__ import annotations

import contextlib
import difflib
import errno
import os
import re
import shlex
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from importlib import import_module

from dynaforge.cli.commands import COMMANDS, ZOO
from dynaforge.cli.terminal import show_anything
from dynaforge.files.versions import PACKAGES, package_versions


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status.

    A user's mistake ends in one line on stderr and status 2, before any long work; work without a result ends in one
    line with the reasons and status 1.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    # Read when numpy and torch are first imported, below. On networks as small as these, a second thread would only
    # take a core away from the workers.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    show_anything()
    if arguments and arguments[0] in ZOO:
        return _zoo(arguments)
    name = arguments[0] if arguments else ""
    if name not in COMMANDS:
        return _overview(name, arguments[1:])
    command = COMMANDS[name]
    try:
        with _sigterm_as_ctrl_c():
            options = command.read(name, arguments[1:])
            options.command = shlex.join(["dynaforge", *arguments])
            return int(import_module(f"dynaforge.cli.{command.module or name}").run(options))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # as with `| head`, which stops reading
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (ValueError, OSError, ImportError) as error:
        return _print_error(name, error, status=2)
    except RuntimeError as error:
        from dynaforge.generators import GaveUp, NoWorkers  # imported already, if it is one of them
        from dynaforge.sampling.vector_errors import WorkerDied

        if not isinstance(error, (GaveUp, NoWorkers, WorkerDied)):
            raise
        return _print_error(name, error, status=1)


def _zoo(arguments: Sequence[str]) -> int:
    """Run a script of rl_zoo3; a mistake that keeps it from starting gives status 2, as in the other commands."""
    from dynaforge.zoo.refusals import ZooFailure
    from dynaforge.zoo.scripts import main as zoo

    try:
        return zoo(arguments)
    except SystemExit as refusal:
        if not isinstance(refusal.code, str):
            raise
        print(refusal.code, file=sys.stderr)
        return 1 if isinstance(refusal.__cause__, ZooFailure) else 2


@contextlib.contextmanager
def _sigterm_as_ctrl_c() -> Iterator[None]:
    """Make SIGTERM, which a batch system sends before it kills, end a command like Ctrl-C, so that it cleans up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _print_error(name: str, error: Exception, *, status: int) -> int:
    """Print the error in one line on stderr, and return the status."""
    message = re.sub(r"\s*[\r\n]\s*", " ", str(error).strip())
    print(f"dynaforge {name}: {message}{_remedy(error)}", file=sys.stderr)
    return status


def _remedy(error: Exception) -> str:
    full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
    return ". Files that are there are whole; make room, then run the same command again" if full else ""


def _overview(name: str, rest: Sequence[str]) -> int:
    texts = {known: command.text for known, command in COMMANDS.items()} | ZOO
    if name in ("-V", "--version"):
        return _version(rest)
    if name not in ("-h", "--help", ""):
        close = difflib.get_close_matches(name, texts, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        print(f"dynaforge: no command {name!r}.{hint} `dynaforge --help` lists them.", file=sys.stderr)
        return 2
    print("usage: dynaforge COMMAND [--help]\n")
    for command, text in texts.items():
        print(f"  {command:<12} {text}")
    print("\nFirst steps: `dynaforge forge --task can` (about 15 minutes), or `dynaforge list`.")
    print("`dynaforge --version` prints the version, `dynaforge --version all` those that results depend on too.")
    return 0


def _version(rest: Sequence[str]) -> int:
    if list(rest) not in ([], ["all"]):
        print(f"dynaforge: --version is followed by nothing or 'all', not by {rest[0]!r}.", file=sys.stderr)
        return 2
    versions = package_versions(PACKAGES if rest else PACKAGES[:1])
    for package, version in versions.items():
        print(f"{package} {version}")
    if rest:
        print(f"python {sys.version.split()[0]}")
    return 0
