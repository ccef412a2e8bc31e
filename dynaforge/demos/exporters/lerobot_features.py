"""The columns of a LeRobot dataset, described as its info.json does."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.exporters.frames import CONTACTS, STATE_NAMES, Frames
from dynaforge.tasks.action import JOINTS

INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index", "subtask_index")

Row = dict[str, Any]


def features(episode: Frames) -> dict[str, Row]:
    """Describe the columns as info.json does.

    LeRobot's policies read `observation.environment_state`, so the true state of the objects has that name where there
    are no pictures; beside pictures it has one that no policy reads.
    """
    found = {
        "observation.state": _vector(STATE_NAMES),
        "observation.joint_velocity": _vector(JOINTS),
        "action": _vector(episode.action_names),
        "next.reward": _scalar("float32"),
        "next.done": _scalar("bool"),
        "next.success": _scalar("bool"),
        "gate": _scalar("bool"),
        "contact": _vector(CONTACTS, "bool"),
    }
    if episode.privileged:
        found[truth_name(episode)] = _vector(f"privileged_{name}" for name in episode.object_names)
    for camera, film in episode.images.items():
        found[f"observation.images.{camera}"] = _film_feature(film, episode.fps)
    for camera, depth in episode.depths.items():
        height, width = even(depth[0]).shape
        found[f"observation.images.{camera}_depth"] = {
            "dtype": "image",
            "shape": [height, width, 1],
            "names": ["height", "width", "channels"],
            "info": {"is_depth_map": True, "depth_unit": "mm"},
        }
    return found | {name: _scalar("float32" if name == "timestamp" else "int64") for name in INDICES}


def _vector(names: Iterable[str], dtype: str = "float32") -> Row:
    names = list(names)
    return {"dtype": dtype, "shape": [len(names)], "names": names}


def _scalar(dtype: str) -> Row:
    return {"dtype": dtype, "shape": [1], "names": None}


def truth_name(episode: Frames) -> str:
    """Return the name of the column with the true state of the objects."""
    return "observation.privileged_state" if episode.images else "observation.environment_state"


def _film_feature(film: NDArray[np.uint8], fps: int) -> Row:
    height, width, _ = even(film[0]).shape
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": height,
            "video.width": width,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.is_depth_map": False,
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
        },
    }


def even(picture: NDArray[Any]) -> NDArray[Any]:
    """Repeat the last row or column where their number is odd: H.264 halves the resolution of colours."""
    if not (picture.shape[0] % 2 or picture.shape[1] % 2):
        return picture
    widths = [(0, size % 2) for size in picture.shape[:2]] + [(0, 0)] * (picture.ndim - 2)
    return np.pad(picture, widths, mode="edge")
