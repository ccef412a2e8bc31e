from __future__ import annotations

import numpy as np
import pytest

from dynaforge.geometry import matrix_from_quat, matrix_from_rotvec, quat_from_matrix
from dynaforge.sim.robot import ELBOW, franka
from dynaforge.tasks.action import ROTATIONS, ActionLayout, without_jumps
from dynaforge.tasks.targets import DOWN_ALONG_X

LAYOUTS = [ActionLayout("joint"), *(ActionLayout("ee", r, e) for r in ROTATIONS for e in (False, True))]


def recording(n: int = 50) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    turns = [matrix_from_rotvec(v) @ DOWN_ALONG_X for v in np.cumsum(0.3 * rng.normal(size=(n, 3)), axis=0)]
    quats = np.array([quat_from_matrix(turn) for turn in turns])
    robot = franka()
    return {
        "projected_action": np.column_stack((rng.uniform(0.2, 0.5, (n, 3)), quats, rng.uniform(0.0, 0.08, n))),
        "ee_quat_wxyz": quats,
        "joint_reference": rng.uniform(robot.q_lower, robot.q_upper, (n, 7)),
        "width_reference": rng.uniform(0.0, 0.08, n),
    }


@pytest.mark.parametrize("layout", LAYOUTS, ids=str)
def test_an_action_says_where_the_recording_went(layout: ActionLayout) -> None:
    steps, robot = recording(), franka()
    rows = layout.of_steps(steps)
    assert rows.shape == (50, len(layout.names))
    low, high = layout.bounds(robot.q_lower, robot.q_upper, robot.width_max)
    as_float = rows.astype(np.float32)
    assert ((low <= as_float) & (as_float <= high)).all()
    for k, row in enumerate(rows):
        if layout.mode == "joint":
            np.testing.assert_array_equal(row[:7], steps["joint_reference"][k])
            assert layout.width(row) == steps["width_reference"][k]
            continue
        target = layout.hand_target(row)
        wanted = steps["projected_action"][k]
        np.testing.assert_array_equal(target.pose.position, wanted[:3])
        np.testing.assert_allclose(target.pose.rotation, matrix_from_quat(wanted[3:7]), atol=1e-9)
        assert target.width == wanted[7]
        if layout.elbow:
            assert row[layout.names.index("elbow")] == steps["joint_reference"][k, ELBOW]


@pytest.mark.parametrize("rotation", ["quat_wxyz", "rotation_6d"])
def test_rotations_do_not_jump_near_a_half_turn(rotation: str) -> None:
    turns = [matrix_from_rotvec((0.0, 0.0, angle)) @ DOWN_ALONG_X for angle in np.linspace(0.0, 4.0 * np.pi, 400)]
    quats = np.array([quat_from_matrix(turn) for turn in turns])
    steps = {
        "projected_action": np.column_stack((np.zeros((400, 3)), quats, np.zeros(400))),
        "ee_quat_wxyz": quats,
    }
    rows = ActionLayout("ee", rotation).of_steps(steps)
    assert np.abs(np.diff(rows, axis=0)).max() < 0.04
    vectors = ActionLayout("ee", "rotvec").of_steps(steps)
    assert np.abs(np.diff(vectors, axis=0)).max() > 6.0  # which is why there is a choice


def test_quaternions_keep_their_sign_through_a_recording() -> None:
    quats = without_jumps(recording()["ee_quat_wxyz"])
    assert ((quats[1:] * quats[:-1]).sum(axis=1) > 0.0).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("joints",), "action_mode is 'joints'; it must be one of 'ee', 'joint'"),
        (("ee", "euler"), "rotation is 'euler'; it must be one of 'quat_wxyz', 'rotvec', 'rotation_6d'"),
        (("joint", "quat_wxyz", True), "Joint positions determine the elbow"),
    ],
)
def test_a_layout_that_makes_no_sense_is_named(arguments: tuple, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ActionLayout(*arguments)


@pytest.mark.parametrize("rotation", ["quat_wxyz", "rotation_6d"])
def test_numbers_that_mean_no_rotation_are_refused(rotation: str) -> None:
    layout = ActionLayout("ee", rotation)
    with pytest.raises(ValueError, match="rotation"):
        layout.hand_target(np.zeros(len(layout.names)))
