"""The films of the page: an episode simulated again with the robot's own meshes, and what its cameras saw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dynaforge.demos import Episode
from dynaforge.demos.observations import ObservationFolder
from dynaforge.demos.replay import Replayer
from dynaforge.geometry import one_line
from dynaforge.reports.video import encode_mp4
from dynaforge.sim.camera import film_camera
from dynaforge.tasks import Task

EVERY = 2  # control steps from picture to picture, as in the clips of a report


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewerEpisode:
    """A recording on the page.

    Attributes:
        id: Of the recording.
        episode: The recording; None where it cannot be read.
        clip: MP4 bytes, or None.
        views: MP4 bytes of what each of its cameras saw, by the camera's name.
        scenes: Links to its scenes in 3-D, relative to the page, by the text of the link.
        note: What could not be shown, in sentences; "" if nothing.
    """

    id: str
    episode: Episode | None
    clip: bytes | None = None
    views: Mapping[str, bytes] = field(default_factory=dict)
    scenes: Mapping[str, str] = field(default_factory=dict)
    note: str = ""

    __repr__ = one_line


class Filmer:
    """Makes the clip of an episode from its replay, at true speed and as the clips of a report look.

    Args:
        task: The task.
    """

    def __init__(self, task: Task) -> None:
        self._replayer = Replayer(task, visuals=True)
        self._camera = film_camera(task.camera)
        self._fps = 1 / (EVERY * task.scene.control_dt)

    def film(self, episode: Episode) -> bytes:
        """Return it as MP4.

        Raises:
            ValueError: The episode cannot be simulated again.
        """
        scene, states = self._replayer.scene, enumerate(self._replayer.recorded_states(episode))
        return encode_mp4([scene.picture(self._camera) for step, _ in states if step % EVERY == 0], fps=self._fps)

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._replayer.close()


def camera_films(observations: ObservationFolder, episode: Episode, *, control_dt: float) -> dict[str, bytes]:
    """Return what each camera saw of an episode as MP4, one picture per control step.

    Args:
        observations: The rendered observations.
        episode: Of which.
        control_dt: Seconds from picture to picture.

    Returns:
        Films by the camera's name; empty where no pictures were kept.

    Raises:
        FileNotFoundError, DamagedFileError: As `ObservationFolder.of`.
        ValueError: The pictures are none.
    """
    if not observations.settings.images:
        return {}
    arrays = observations.of(episode)
    names = [camera.name for camera in observations.settings.cameras]
    return {name: encode_mp4(arrays[f"{name}/rgb"], fps=1 / control_dt) for name in names if f"{name}/rgb" in arrays}
