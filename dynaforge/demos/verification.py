"""Verification of a folder of demonstrations, file by file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import episode_checks as checks
from dynaforge.demos.audit import audit
from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.differences import first_row
from dynaforge.demos.episode import Episode
from dynaforge.demos.folder_checks import Finding, Notes, read_notes, verify_folder
from dynaforge.demos.observations import ObservationFolder
from dynaforge.demos.replay import Replayer
from dynaforge.demos.untrusted import MALFORMED_FILE_ERRORS, DamagedFileError, printable
from dynaforge.tasks import Task

Render = Callable[[Episode], Mapping[str, NDArray[Any]]]


class EpisodeVerifier:
    """Checks one recording after another: its content, its rendered observations and, if asked to, its physics.

    Args:
        dataset: The recordings.
        notes: What the folder contains besides them.
        task: Their task; without it their columns are not compared with each other.
        again: Makes an attempt again from its recording, as `dynaforge.generators.repeat.Repeater` does.
        replayer: Replays an episode that `again` cannot repeat, and looks for deep overlaps.
        audited: Whether to look for impossible motion too.
        render: Renders an episode again, as `ObservationRenderer.render` does with the settings of the folder.
    """

    def __init__(
        self,
        dataset: DemonstrationDataset,
        notes: Notes,
        *,
        task: Task | None = None,
        again: Callable[[Episode], Episode] | None = None,
        replayer: Replayer | None = None,
        audited: bool = False,
        render: Render | None = None,
    ) -> None:
        self._dataset, self._observations, self._render = dataset, notes.observations, render
        self._notes_fit = [
            checks.digests,
            checks.of_source(notes.sources),
            checks.rewards,
            checks.of_ledger(notes.attempts),
        ]
        self._motion_fits = [checks.of_physics(again, replayer)]
        if task is not None:
            self._motion_fits.insert(0, checks.of_task(task))
        if audited:
            self._motion_fits.append(lambda episode: map(str, audit(episode, replayer=replayer)))

    def __call__(self, name: str) -> list[Finding]:
        """Check the recording with an id; whatever is wrong with it is a finding, never an exception."""
        path = self._dataset.file_of(name)
        try:
            episode = self._dataset[name]
        except DamagedFileError as error:
            return [Finding(path, error.reason)]
        except KeyError:
            return [Finding(path, "it was there when the folder was listed, and is gone")]
        with np.errstate(all="ignore"):  # forged numbers may overflow
            problems = _problems(self._notes_fit, episode)
            # The motion is checked only where all numbers are finite.
            problems += _problems([checks.numbers], episode) or _problems(self._motion_fits, episode)
        return [Finding(path, problem) for problem in problems] + self._wrong_observations(episode)

    def _wrong_observations(self, episode: Episode) -> list[Finding]:
        if self._observations is None:
            return []
        try:
            return wrong_observations(self._observations, episode, self._render)
        except FileNotFoundError:  # they were not rendered
            return []
        except DamagedFileError as error:
            return [Finding(error.path, error.reason)]
        except MALFORMED_FILE_ERRORS as error:
            path = self._observations.file_of(episode.id)
            return [Finding(path, f"it cannot be rendered again: {printable(error)}")]


def wrong_observations(folder: ObservationFolder, episode: Episode, render: Render | None) -> list[Finding]:
    """Check the rendered observations of an episode and, if asked to, compare them with what rendering gives now.

    Args:
        folder: The rendered observations.
        episode: The recording.
        render: Renders it again; None for no comparison.

    Raises:
        FileNotFoundError, DamagedFileError: As for `ObservationFolder.of`.
    """
    arrays = folder.of(episode)
    if render is None:
        return []
    again = render(episode)
    first = {name: first_row(array, again[name]) for name, array in arrays.items()}
    return [
        Finding(folder.file_of(episode.id), f"{name} is not what rendering gives from step {step} on")
        for name, step in first.items()
        if step is not None
    ]


def verify(
    dataset: DemonstrationDataset,
    *,
    task: Task | None = None,
    again: Callable[[Episode], Episode] | None = None,
    replayer: Replayer | None = None,
    audited: bool = False,
) -> Iterator[list[Finding]]:
    """Check everything: yield the findings of the folder as a whole, then those of each recording in turn.

    Args:
        dataset: The folder.
        task: As for `EpisodeVerifier`.
        again: As for `EpisodeVerifier`.
        replayer: As for `EpisodeVerifier`.
        audited: As for `EpisodeVerifier`.
    """
    notes = read_notes(dataset)
    yield verify_folder(dataset, notes, task)
    check = EpisodeVerifier(dataset, notes, task=task, again=again, replayer=replayer, audited=audited)
    yield from map(check, notes.names)


def _problems(chosen: Sequence[checks.Check], episode: Episode) -> list[str]:
    """Run each check to its end, or to where the recording stops it with an error, which is a problem itself."""
    problems: list[str] = []
    for check in chosen:
        try:
            problems.extend(check(episode))
        except MALFORMED_FILE_ERRORS as error:
            problems.append(f"it cannot be checked to the end: {printable(error) or type(error).__name__}")
    return problems
