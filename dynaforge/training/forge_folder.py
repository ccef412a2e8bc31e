"""The folder of a run of `forge`: what was asked for and every finished stage, so that the same command resumes it.

Read before anything heavy is imported.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import Any

from dynaforge.files.atomic import atomic_write, make_folder
from dynaforge.tasks import get_task

ABOUT = "forge.json"
REPORT = "report.html"  # written last
ASKED = ("budget", "updates", "demos", "attempts", "seed", "algo", "residual_frame")


class ForgeFolder:
    """A folder of one run; plain data, so that going on from somebody's folder runs no code.

    Attributes:
        path: The folder.
        resumed: Whether it holds the beginning of the run already.
    """

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        self.path = path
        self.resumed = (path / ABOUT).is_file()
        if not self.resumed:
            atomic_write(path / ABOUT, json.dumps(about, indent=1).encode() + b"\n")

    @staticmethod
    def of(path: Path, about: Mapping[str, Any]) -> ForgeFolder:
        """Open a folder that is new, empty, or of this very run.

        Raises:
            ValueError: It cannot be made, or holds another run.
            PermissionError: It cannot be written to.
        """
        asked: dict[str, Any] = json.loads(json.dumps(about))
        stored = _read(path / ABOUT) if (path / ABOUT).is_file() else asked
        if stored != asked:
            differ = {name for name in {*stored, *asked} if stored.get(name) != asked.get(name)}
            was, now = ({name: side.get(name) for name in differ} for side in (stored, asked))
            raise ValueError(
                f"--out {path} holds a run with {_spell(was)}, now {_spell(now)} is asked for. "
                "Choose another --out, or repeat the command of that run to go on with it."
            )
        make_folder(path)
        return ForgeFolder(path, asked)

    @property
    def finished(self) -> bool:
        """Whether the run came to its end."""
        return (self.path / REPORT).is_file()

    def has_stage(self, name: str) -> bool:
        """Tell whether a stage was stored."""
        return (self.path / f"{name}.json").is_file()

    def stage(self, name: str, make: Callable[[], Any]) -> Any:
        """Return the plain data of a stage: stored by an earlier call of the command, or made now and stored."""
        path = self.path / f"{name}.json"
        if not self.has_stage(name):
            atomic_write(path, json.dumps(make()).encode() + b"\n")
        return _read(path)


def asked_for(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the arguments say of a run, as plain data; how many workers make it may change."""
    return {name: getattr(options, name) for name in ASKED} | {"task": get_task(options.task).name}


def default_folder(options: argparse.Namespace) -> Path:
    """Return the latest runs/TASK-N if it waits to go on with the same arguments, else the next free one."""
    asked = asked_for(options)
    stem = f"runs/{asked['task']}"
    free = next(k for k in count(1) if not Path(f"{stem}-{k}").exists())
    latest = Path(f"{stem}-{free - 1}")
    if (latest / ABOUT).is_file() and not (latest / REPORT).is_file():
        held = _read(latest / ABOUT)
        if all(held.get(name) == value for name, value in asked.items()):
            return latest
    return Path(f"{stem}-{free}")


def _read(path: Path) -> Any:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged ({error}). Remove it to have this stage made again.") from error
    if not isinstance(data, dict):
        raise ValueError(f"{path} holds {type(data).__name__}, expected a mapping. Remove it to have it made again.")
    return data


def _spell(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in sorted(values.items()))
