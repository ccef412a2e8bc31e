"""A folder of demonstrations: one file per episode, a ledger of every attempt, and nothing that a kill can break."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from dynaforge.demos.episode import Attempt, Episode
from dynaforge.demos.episode_file import FORMAT_VERSION, SUFFIX, read_episode, write_episode
from dynaforge.demos.ledger import Ledger
from dynaforge.demos.provenance import Provenance, check_lead_time, check_setting
from dynaforge.demos.untrusted import DamagedFileError, files_in, kind_of, printable, read_json
from dynaforge.files.atomic import atomic_write, check_writable, is_temporary, remove_stale, sync_folder
from dynaforge.sim.checks import check_flag, check_kind, check_task_name

FORMAT = "dynaforge-demonstrations"
_MARKER = "dataset.json"
SOURCES = "generators.json"
EPISODES = "episodes"
_LEDGER = "ledger.jsonl"
NOTES = (_MARKER, SOURCES, _LEDGER)


class DemonstrationDataset:
    """Demonstrations of one task in a folder: `dataset.json`, `ledger.jsonl`, `episodes/<id>.h5`.

    There is no index file: the names in `episodes/` are the index. Any number of processes may add to one folder,
    and repeating an attempt only replaces its own file.

    Args:
        path: The folder.
        task: Name of the task, which opens the folder for adding and creates it if it does not exist. Without it an
            existing folder is opened for reading only.
        keep_failures: Whether `add` keeps the recordings of failed episodes too; the ledger lists them in any case.

    Raises:
        FileNotFoundError: The folder contains no dataset and no task was given.
        DamagedFileError: Its `dataset.json` cannot be read.
        FileExistsError: The folder contains other data.
        PermissionError: A task was given and the folder cannot be created or written to.
        ValueError: The folder belongs to another task, or was written by a newer version; or `task` cannot name one.
    """

    def __init__(self, path: str | Path, *, task: str | None = None, keep_failures: bool = False) -> None:
        check_kind("path", path, (str, Path))
        if path == "":
            raise ValueError("path is ''; name a folder, '.' for the current one.")
        check_flag("keep_failures", keep_failures)
        if task is not None:
            check_task_name("task", task)
        self.path = Path(path)
        self.writable = task is not None
        self.keep_failures = keep_failures
        if task is not None:
            _prepare(self.path, task)
        self.task = _read_marker(self.path)
        if task is not None and task != self.task:
            raise ValueError(f"{path} holds demonstrations of {self.task!r}, not of {task!r}. Choose another folder.")
        self.ledger = Ledger(self.path / _LEDGER)
        if self.writable:
            self._open_for_adding()

    def add(self, episode: Episode, *, wall_seconds: float = 0.0, block: int = 0) -> Attempt:
        """Record an episode as an attempt; see `record`.

        Args:
            episode: What happened, successful or not.
            wall_seconds: Real time that it took; 0 where it is not known.
            block: Block of conditions that it belongs to.

        Returns:
            The attempt as the ledger lists it.

        Raises:
            PermissionError, ValueError, OSError: As `record`.
        """
        check_kind("episode", episode, Episode)
        return self.record(Attempt.of(episode, wall_seconds=wall_seconds, block=block), episode)

    def record(self, attempt: Attempt, episode: Episode | None = None) -> Attempt:
        """Record an attempt; its recording, if it is kept, is on disk before its line in the ledger.

        The recordings of the successes are the demonstration set D of Eq. 2.

        Args:
            attempt: What happened.
            episode: Its recording; None where it left none (an exception, a worker that died). It counts all the same.

        Returns:
            The attempt as the ledger lists it, including whether its recording was kept.

        Raises:
            PermissionError: The dataset was opened for reading only.
            ValueError: The attempt is at another task, or the episode belongs to another attempt.
            OSError: The disk is full or the folder has gone; nothing that was added before is lost.
        """
        check_kind("attempt", attempt, Attempt)
        check_kind("episode", episode, (Episode, type(None)))
        self._check(attempt.condition.task)
        if episode is not None and (episode.success or self.keep_failures):
            if episode.id != attempt.id:
                raise ValueError(f"The episode is {episode.id}, the attempt {attempt.id}; they must be one.")
            write_episode(self.file_of(episode.id), episode)
            attempt = replace(attempt, recorded=True)
        self.ledger.append(attempt)
        return attempt

    def attempts(self) -> list[Attempt]:
        """Return every attempt once: those in the ledger, then those that a kill left with a recording only."""
        found = {attempt.id: attempt for attempt in self.ledger.attempts()}
        for name in self.ids():
            if name not in found:
                found[name] = Attempt.of(self[name], recorded=True)
        return list(found.values())

    def missing_recordings(self) -> list[Attempt]:
        """Return the attempts in the ledger whose recording was kept and no longer exists."""
        names = set(self.ids())
        return [a for a in self.ledger.attempts() if (a.success or a.recorded) and a.id not in names]

    def sources(self) -> dict[str, Provenance]:
        """Return what made the attempts of each generator, by the generator's name, as far as it was noted.

        Raises:
            DamagedFileError: The file cannot be read.
        """
        path = self.path / SOURCES
        try:
            data = read_json(path)
        except FileNotFoundError:
            return {}
        try:
            return {name: Provenance.from_dict(noted) for name, noted in data.items()}
        except (ValueError, TypeError, AttributeError) as error:
            raise DamagedFileError(path, f"it does not say what made the episodes ({printable(error)})") from error

    def note_source(self, generator: str, source: Provenance) -> None:
        """Note what makes a generator's attempts, so that those of two policies, definitions or settings never mix.

        Raises:
            PermissionError: The dataset was opened for reading only.
            ValueError: The folder contains attempts of another policy, with another definition of the task, or, by
                whatever generator, under another setting or with another prediction in the planner.
        """
        self._check(self.task)
        sources = self.sources()
        check_setting(str(self.path), sources.values(), source.setting)
        check_lead_time(str(self.path), sources.values(), source.lead_time)
        noted = sources.get(generator)
        if noted == source:
            return
        if noted is None:
            sources[generator] = source
            text = json.dumps({name: each.to_dict() for name, each in sources.items()}, indent=1)
            atomic_write(self.path / SOURCES, text.encode() + b"\n")
        elif noted.policy != source.policy:
            raise ValueError(
                f"{self.path} holds attempts of policy {noted.policy or 'none'}, not of {source.policy or 'none'}. "
                "Choose another folder."
            )
        else:
            raise ValueError(
                f"{self.path} holds attempts with another definition of task {self.task!r}. Choose another folder."
            )

    def dgr(self) -> float:
        """Return the demonstration generation rate, successes over all attempts of all generators; NaN without any."""
        attempts = self.attempts()
        return sum(attempt.success for attempt in attempts) / len(attempts) if attempts else float("nan")

    def ids(self) -> list[str]:
        """Return the ids of the recorded episodes, sorted.

        Raises:
            DamagedFileError: `episodes` is no folder, or cannot be read.
        """
        return [path.stem for path in files_in(self.path / EPISODES, SUFFIX) if not is_temporary(path)]

    def file_of(self, episode_id: str) -> Path:
        """Return where an episode is, or would be, stored."""
        return self.path / EPISODES / f"{episode_id}{SUFFIX}"

    def __len__(self) -> int:
        return len(self.ids())

    def __repr__(self) -> str:
        try:
            n = len(self)
            contents = f"{n} episode{'s' if n != 1 else ''}"
        except DamagedFileError:
            contents = "damaged"
        return f"DemonstrationDataset({str(self.path)!r}, {self.task}, {contents})"

    def __iter__(self) -> Iterator[Episode]:
        return (self[name] for name in self.ids())

    def __getitem__(self, episode_id: str) -> Episode:
        """Read one episode by its id.

        Raises:
            KeyError: There is no episode with that id.
            DamagedFileError: Its file was altered, or holds another episode.
        """
        path = self.file_of(episode_id)
        try:
            episode = read_episode(path)
        except FileNotFoundError as error:
            raise KeyError(f"No episode {episode_id!r} in {self.path}.") from error
        if episode.id != episode_id or episode.condition.task != self.task:
            raise DamagedFileError(path, f"it holds episode {episode.id} of task {episode.condition.task!r}")
        return episode

    def _check(self, task: str) -> None:
        if not self.writable:
            raise PermissionError(f"{self.path} was opened for reading; pass task={self.task!r} to add to it.")
        if task != self.task:
            raise ValueError(f"{self.path} holds demonstrations of {self.task!r}; the attempt is one at {task!r}.")

    def _open_for_adding(self) -> None:
        episodes = self.path / EPISODES
        episodes.mkdir(exist_ok=True)
        sync_folder(self.path)
        for folder in (self.path, episodes):
            check_writable(folder)
            remove_stale(folder)
        noted = {attempt.id for attempt in self.ledger.attempts()}
        for name in self.ids():
            if name not in noted:  # a kill came between writing the file and its line
                self.ledger.append(Attempt.of(self[name], recorded=True))


def _prepare(path: Path, task: str) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise FileExistsError(f"{path} is a file; demonstrations need a folder.") from None
    except OSError as error:
        raise PermissionError(f"Cannot create {path}: {error.strerror}. Choose another folder.") from error
    others = sorted(entry.name for entry in path.iterdir() if not is_temporary(entry))
    if (path / _MARKER).exists():  # checked after listing: another collector may be creating the folder right now
        return
    if others:
        raise FileExistsError(f"{path} holds other data ({', '.join(others[:3])}). Choose an empty or new folder.")
    check_writable(path)
    marker = {"format": FORMAT, "version": FORMAT_VERSION, "task": task}
    atomic_write(path / _MARKER, json.dumps(marker, indent=2).encode() + b"\n")


def _read_marker(path: Path) -> str:
    marker = path / _MARKER
    kind = kind_of(path)
    if kind != "a folder":
        problem = f"it is {kind}, not a folder" if kind else "there is no such folder"
        raise FileNotFoundError(f"{printable(path)} holds no demonstrations: {problem}.")
    try:
        data = read_json(marker)
    except FileNotFoundError:
        raise FileNotFoundError(f"{printable(path)} holds no demonstrations: it has no {_MARKER}.") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT or not isinstance(data.get("task"), str):
        raise DamagedFileError(marker, f"it does not describe a folder of format {FORMAT!r}")
    if data.get("version") != FORMAT_VERSION:
        raise ValueError(
            f"{printable(path)} has format version {data.get('version')!r:.20}; this dynaforge reads {FORMAT_VERSION}."
        )
    try:
        check_task_name("task", data["task"])  # never a path: opening a folder imports nothing
    except ValueError:
        raise DamagedFileError(marker, f"{data['task']!r:.80} is no name of a task") from None
    return str(data["task"])
