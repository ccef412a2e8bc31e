"""The folder of a run of `forge`: its request and every finished stage, so that the same command resumes it.

The command line reads this module before anything heavy is imported.
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
from dynaforge.training.run_spec import setting_in_words

REQUEST = "forge.json"
REPORT = "report.html"  # written last
REQUESTED = ("budget", "updates", "demos", "attempts", "seed", "algo", "residual_frame")


class ForgeFolder:
    """The folder of one run; plain data, so that resuming somebody else's folder executes no code.

    Args:
        path: The folder.
        request: What identifies the run, as plain data; stored if the folder is new.

    Attributes:
        path: The folder.
        resumed: Whether it already contains the beginning of the run.
    """

    def __init__(self, path: Path, request: Mapping[str, Any]) -> None:
        self.path = path
        self.resumed = (path / REQUEST).is_file()
        if not self.resumed:
            atomic_write(path / REQUEST, json.dumps(request, indent=1).encode() + b"\n")

    @staticmethod
    def of(path: Path, request: Mapping[str, Any]) -> ForgeFolder:
        """Open a folder that is new, empty, or of this very run.

        Args:
            path: The folder.
            request: What identifies the run, as plain data.

        Raises:
            ValueError: It cannot be made, or contains another run.
            PermissionError: It cannot be written to.
        """
        requested: dict[str, Any] = json.loads(json.dumps(request))
        stored = _read(path / REQUEST) if (path / REQUEST).is_file() else requested
        if stored != requested:
            differ = {name for name in {*stored, *requested} if stored.get(name) != requested.get(name)}
            was, now = ({name: side.get(name) for name in differ} for side in (stored, requested))
            raise ValueError(
                f"--out {path} holds a run with {_spell(was)}, now {_spell(now)} is asked for. "
                "Choose another --out, or repeat the command of that run to resume it."
            )
        make_folder(path)
        return ForgeFolder(path, requested)

    @property
    def finished(self) -> bool:
        """Whether the run is complete."""
        return (self.path / REPORT).is_file()

    def has_stage(self, name: str) -> bool:
        """Return whether a stage is stored."""
        return (self.path / f"{name}.json").is_file()

    def stage(self, name: str, make: Callable[[], Any]) -> Any:
        """Return the plain data of a stage: what an earlier call stored, or else what is made and stored now.

        Args:
            name: Name of the stage.
            make: Makes the data.
        """
        path = self.path / f"{name}.json"
        if not self.has_stage(name):
            atomic_write(path, json.dumps(make()).encode() + b"\n")
        return _read(path)


def asked_for(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments that identify a run, as plain data; the number of workers may change."""
    task = get_task(options.task).under(reflex=options.reflex, physics=options.physics, sensing=options.sensing)
    asked = {name: getattr(options, name) for name in REQUESTED}
    return asked | {"task": task.name, "setting": task.setting.to_dict()}


def default_folder(options: argparse.Namespace) -> Path:
    """Return the latest runs/TASK-N if it is an unfinished run with the same arguments, else the next free one."""
    requested = asked_for(options)
    stem = f"runs/{requested['task']}"
    free = next(k for k in count(1) if not Path(f"{stem}-{k}").exists())
    latest = Path(f"{stem}-{free - 1}")
    if (latest / REQUEST).is_file() and not (latest / REPORT).is_file():
        stored = _read(latest / REQUEST)
        if all(stored.get(name) == value for name, value in requested.items()):
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
    words = {name: setting_in_words(value) if name == "setting" else value for name, value in sorted(values.items())}
    return ", ".join(f"{name} {value}" for name, value in words.items())
