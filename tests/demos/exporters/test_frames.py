"""What `read_frames` hands to exporters, and what it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaforge.demos import DamagedFileError, DemonstrationDataset
from dynaforge.demos.exporters import read_frames
from dynaforge.demos.observations import ObservationFolder
from dynaforge.geometry import matrix_from_quat, matrix_from_rotation_6d

FPS = 30


def test_six_numbers_stand_for_the_rotation_that_the_quaternion_does(recorded: DemonstrationDataset) -> None:
    quats, sixes = (
        next(read_frames(recorded, fps=FPS, failures=True, rotation=rotation))
        for rotation in ("quat_wxyz", "rotation_6d")
    )
    assert sixes.action_names == ("x", "y", "z", "r1x", "r1y", "r1z", "r2x", "r2y", "r2z", "width", "elbow")
    np.testing.assert_array_equal(sixes.actions[:, [0, 1, 2, 9, 10]], quats.actions[:, [0, 1, 2, 7, 8]])
    for six, quat in zip(sixes.actions[:, 3:9], quats.actions[:, 3:7], strict=True):
        np.testing.assert_allclose(matrix_from_rotation_6d(six), matrix_from_quat(quat), atol=1e-6)


def test_phase_gate_and_contact_are_those_of_the_recording(recorded: DemonstrationDataset) -> None:
    for frames in read_frames(recorded, fps=FPS, failures=True):
        steps = frames.episode.steps
        np.testing.assert_array_equal(frames.phase, steps["phase"])
        np.testing.assert_array_equal(frames.gate, steps["gate"])
        np.testing.assert_array_equal(frames.contact[:, 1], steps["right_contact"])


@pytest.mark.parametrize("fps", [0, -1, "x", None, 2.5, True, float("nan")])
def test_a_rate_that_is_none_is_refused_when_asked_and_not_when_read(tmp_path: Path, fps: Any) -> None:
    dataset = DemonstrationDataset(tmp_path / "can", task="can")
    with pytest.raises(ValueError, match="whole number of control steps a second"):
        read_frames(dataset, fps=fps)


def test_a_rate_that_is_not_the_recordings_is_refused(recorded: DemonstrationDataset) -> None:
    with pytest.raises(ValueError, match="recorded at 30 control steps a second, not 10"):
        next(read_frames(recorded, fps=10, failures=True))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"actions": "eef"}, "Did you mean 'ee'"),
        ({"rotation": "rotation_6D"}, "Did you mean 'rotation_6d'"),
        ({"actions": "joint", "rotation": "rotation_6d"}, "Joint positions have no rotation"),
    ],
)
def test_unknown_actions_are_refused_with_the_nearest(tmp_path: Path, options: dict[str, str], message: str) -> None:
    dataset = DemonstrationDataset(tmp_path / "can", task="can")
    with pytest.raises(ValueError, match=message):
        read_frames(dataset, fps=FPS, **options)  # type: ignore[arg-type]


def test_cameras_are_those_of_the_settings_whatever_a_file_holds(recorded: DemonstrationDataset) -> None:
    """A file may hold arrays of any name, `../../x/rgb` among them, but then it is none of these observations."""
    seen = ObservationFolder(recorded.path / "observations")
    episode = next(iter(recorded))
    path, held = seen.file_of(episode.id), seen.file_of(episode.id).read_bytes()
    arrays = seen.of(episode)
    try:
        for forged, what in (
            (arrays | {"../../x/rgb": arrays["front/rgb"]}, r"x/rgb is none of its arrays"),
            ({k: v for k, v in arrays.items() if k != "front/depth"}, r"front/depth is missing"),
            (arrays | {"points": arrays["points"][1:]}, r"points is \(\d+, "),
        ):
            seen.write(episode, forged, [])
            with pytest.raises(DamagedFileError, match=what):
                next(read_frames(recorded, fps=FPS, observations=seen, failures=True))
    finally:
        path.write_bytes(held)
