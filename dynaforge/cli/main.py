"""The `dynaforge` command."""

from __future__ import annotations

import argparse
import contextlib
import difflib
import errno
import os
import shlex
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from importlib import import_module

COMMANDS = {
    "forge": "from nothing to demonstrations: measure the prior, train, measure again, collect, report",
    "list": "the tasks",
    "describe": "one task: motion, randomisation, phases, success",
    "evaluate": "demonstration generation rate of a generator on stored condition streams",
    "collect": "demonstrations into a folder, on all cores; resumes",
    "info": "what a folder of demonstrations holds: rates, lengths, ranges, size",
    "render": "pictures and point clouds of collected episodes, in a second pass; resumes",
    "view": "one HTML page to look through a folder of demonstrations: clips, plots, filters",
    "export": "demonstrations as LeRobot, robomimic, DP3's zarr or Minari data, with a card",
    "verify": "check a folder of demonstrations: bytes, values, outcomes; --replay simulates them again",
    "compare": "train several algorithms on the same tasks and seeds, measure and report; resumes",
    "bench": "the project's figures: speed, determinism, limits",
    "train": "rl_zoo3's train, with FrontierGRPO and the DynaForge envs registered",
    "enjoy": "rl_zoo3's enjoy: play a trained policy",
    "record_video": "rl_zoo3's record_video: an MP4 of it",
}
ZOO = ("train", "enjoy", "record_video")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status.

    A user's mistake ends in one line on stderr and status 2, before any long work.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    # Read when numpy and torch are first imported, below. The cores belong to the workers: on networks as small as
    # these, a second thread only takes a core away from them.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if arguments and arguments[0] in ZOO:
        from dynaforge.cli.zoo import main as zoo

        return zoo(arguments)
    name = arguments[0] if arguments else ""
    if name not in COMMANDS:
        return _overview(name)
    module = import_module(f"dynaforge.cli.{name.replace('list', 'describe')}")
    parser = argparse.ArgumentParser(
        prog=f"dynaforge {name}", description=COMMANDS[name], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    module.add_arguments(parser, name)
    options = parser.parse_args(arguments[1:])
    options.command = shlex.join(["dynaforge", *arguments])
    try:
        with _sigterm_as_ctrl_c():
            return int(module.run(options))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # as with `| head`: nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (ValueError, OSError, ImportError) as error:
        print(f"dynaforge {name}: {error}{_remedy(error)}", file=sys.stderr)
        return 2


@contextlib.contextmanager
def _sigterm_as_ctrl_c() -> Iterator[None]:
    """Let SIGTERM, which a batch system sends before it kills, end a command as Ctrl-C does: cleaned up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _remedy(error: Exception) -> str:
    full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
    return ". Files that are there are whole; make room, then run the same command again" if full else ""


def _overview(name: str) -> int:
    asked = name in ("-h", "--help", "")
    if not asked:
        close = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        print(f"dynaforge: no command {name!r}.{hint} `dynaforge --help` lists them.", file=sys.stderr)
        return 2
    print("usage: dynaforge COMMAND [--help]\n")
    for command, text in COMMANDS.items():
        print(f"  {command:<12} {text}")
    print("\nFirst steps: `dynaforge forge --task can` (about 15 minutes), or `dynaforge list`.")
    return 0
