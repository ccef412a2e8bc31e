from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaforge.geometry import JointTrajectory, Pose, one_line


@dataclass
class Value:
    array: Any
    mapping: Mapping[str, Any]
    parts: tuple[Any, ...]

    __repr__ = one_line


def test_short_arrays_are_written_out_and_long_ones_by_type_and_shape() -> None:
    shown = Value(np.zeros((100, 7)), {"can": np.zeros(99), "bowl": 1}, (np.array((0.1 + 0.2, 1.0)), "a\nb", b"film"))
    assert repr(shown) == "Value(array=float64[100, 7], mapping={can, bowl}, parts=[[0.3, 1.0], 'a\\nb', 4 bytes])"
    assert repr(Value(None, {str(k): k for k in range(99)}, (1,) * 99)) == (
        "Value(array=None, mapping=99 entries, parts=99 entries)"
    )


def test_a_pose_and_a_trajectory_are_one_line() -> None:
    pose = "Pose(rotation=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], position=[0.0, 0.0, 0.0])"
    assert repr(Pose.identity()) == pose
    joints = np.zeros((93, 7))
    shown = "JointTrajectory(dt=0.1, q=float64[93, 7], dq=float64[93, 7], ddq=float64[93, 7])"
    assert repr(JointTrajectory(0.1, joints, joints, joints)) == shown
