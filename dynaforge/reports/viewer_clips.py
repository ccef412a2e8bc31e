"""The films on the page: an episode simulated again with the robot's own meshes, and what its cameras recorded."""

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

FRAME_STEPS = 2  # control steps from frame to frame, as in the clips of a report


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewerEpisode:
    """A recording on the page.

    Attributes:
        id: Id of the recording.
        episode: The recording; None if it cannot be read.
        clip: Its film, MP4 bytes, or None.
        views: The film of each of its cameras, MP4 bytes, by the camera's name.
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
    """Films episodes by replaying them, at real speed and in the style of the clips of a report.

    Args:
        task: The task.
    """

    def __init__(self, task: Task) -> None:
        self._replayer = Replayer(task, visuals=True)
        self._camera = film_camera(task.camera)
        self._fps = 1 / (FRAME_STEPS * task.scene.control_dt)

    def film(self, episode: Episode) -> bytes:
        """Return the film of an episode, MP4 bytes.

        Raises:
            ValueError: The episode cannot be simulated again.
        """
        scene = self._replayer.scene
        frames = [
            scene.picture(self._camera)
            for step, _ in enumerate(self._replayer.recorded_states(episode))
            if step % FRAME_STEPS == 0
        ]
        return encode_mp4(frames, fps=self._fps)

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._replayer.close()


def camera_films(observations: ObservationFolder, episode: Episode, *, control_dt: float) -> dict[str, bytes]:
    """Return what each camera saw of an episode, one picture per control step.

    Args:
        observations: The rendered observations.
        episode: The episode.
        control_dt: Seconds from picture to picture.

    Returns:
        Films, MP4 bytes, by the camera's name; empty if no pictures were stored.

    Raises:
        FileNotFoundError, DamagedFileError: As `ObservationFolder.of`.
        ValueError: What is stored are not pictures.
    """
    if not observations.settings.images:
        return {}
    arrays = observations.of(episode)
    names = [camera.name for camera in observations.settings.cameras]
    return {name: encode_mp4(arrays[f"{name}/rgb"], fps=1 / control_dt) for name in names if f"{name}/rgb" in arrays}
