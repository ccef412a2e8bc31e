"""Refusals that end a command of rl_zoo3 in one line: unknown names, untrusted checkpoints, no display."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dynaforge.tasks import suggestion
from dynaforge.zoo.algorithm import ALGORITHMS
from dynaforge.zoo.flags import zoo_algorithms


class ZooFailure(Exception):  # noqa: N818 - it wraps an error of any kind
    """The error that ended a script of rl_zoo3: a mistake in the command line, or one that needs no traceback."""

    def __str__(self) -> str:
        error = self.args[0]
        kind = "" if isinstance(error, (ValueError, AssertionError, OSError)) else f"{type(error).__name__}: "
        return kind + (str(error) or type(error).__name__)


@contextmanager
def one_line(script: str) -> Iterator[None]:
    """End the process with one line on a mistake.

    Raises:
        SystemExit: A ValueError or a ZooFailure was raised; its message is the line.
    """
    try:
        yield
    except (ValueError, ZooFailure) as error:
        raise SystemExit(f"dynaforge {script}: {' '.join(str(error).split())}") from error


def check_trust(script: str, options: argparse.Namespace) -> None:
    """Refuse to load an SB3 checkpoint without --trusted, since unpickling runs code stored in it."""
    if (script != "train" or options.trained_agent) and not options.trusted:
        checkpoint = options.trained_agent or "an rl_zoo3 checkpoint"
        raise SystemExit(
            f"dynaforge {script}: loading {checkpoint} can run code stored in it; add --trusted if it is your own"
        )


def check_statistics(options: argparse.Namespace) -> None:
    """Refuse to unpickle without --trusted the file that rl_zoo3 would load as the statistics of an earlier run."""
    name = options.env.rpartition(":")[2].replace("/", "-")
    statistics = Path(options.trained_agent).parent / name / "vecnormalize.pkl"
    if statistics.exists() and not options.trusted:
        raise SystemExit(
            f"dynaforge train: rl_zoo3 loads {statistics}, which can run code stored in it; add --trusted if it is "
            "your own, or start elsewhere"
        )


def check_display(script: str, options: argparse.Namespace, flags: list[str]) -> None:
    """Refuse to play in a window where none can be opened, before anything is loaded.

    Args:
        script: The script of rl_zoo3; only `enjoy` opens a window.
        options: Its parsed flags.
        flags: Its flags as given, including those that are passed on to the env.
    """
    if (
        script != "enjoy"
        or not options.env.startswith("DynaForge/")
        or "--no-render" in flags
        or any("render_mode" in flag for flag in flags)
    ):
        return
    from dynaforge.sim.bullet import missing_display

    if problem := missing_display():
        raise SystemExit(
            f"dynaforge enjoy: it opens a window, but {problem}; add --no-render, or make a film with record_video"
        )


def check_algorithm(algo: str) -> None:
    """Refuse an unknown algorithm."""
    known = (*zoo_algorithms(), *ALGORITHMS)
    if algo not in known:
        close = difflib.get_close_matches(algo, known, n=1, cutoff=0.5)
        hint = f" Did you mean {close[0]!r}?" if close else f" Known are {', '.join(known)}."
        raise SystemExit(f"dynaforge: no algorithm {algo!r}.{hint}")


def check_env(env: str) -> None:
    """Refuse an env that is not registered; those of other packages are registered once rl_zoo3 is imported."""
    import gymnasium as gym

    if env not in gym.registry:
        raise SystemExit(f"dynaforge: no env {env!r}. {suggestion(env, among=gym.registry)}")
