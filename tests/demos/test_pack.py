from __future__ import annotations

import os
import pickle
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demo_episodes import make_episode

from dynaforge.demos import DamagedFileError
from dynaforge.demos.exporters import Frames
from dynaforge.demos.pack import Pack
from dynaforge.tasks.action import ActionLayout


def frames(k: int, n: int, *, points: bool = True) -> Frames:
    """Frames whose state, action and points all tell episode and step: 100 k + step."""
    label = (100 * k + np.arange(n, dtype=np.float32))[:, None]
    robot = {"ee_position": label, "ee_quat_wxyz": label, "width": label, "q": label, "dq": label}
    cloud = np.repeat(label[:, None], 3, axis=2) if points else None
    return Frames(
        fps=30,
        robot=robot,
        objects={},
        privileged=False,
        actions=label,
        layout=ActionLayout("joint"),
        rewards=label[:, 0],
        phase=np.full(n, k),
        gate=np.ones(n, dtype=bool),
        contact=np.zeros((n, 2), dtype=bool),
        images={},
        depths={},
        points=cloud,
        point_colors=None,
        episode=make_episode(k),
    )


def test_windows_stay_within_their_episode(tmp_path: Path) -> None:
    pack = Pack.write(tmp_path / "pack", [frames(1, 4), frames(2, 3)])
    assert len(pack) == 7
    assert pack.episode_ends.tolist() == [4, 7]
    assert pack.window("action", 2, before=1, after=1)[:, 0].tolist() == [101, 102, 103]
    assert pack.window("action", 0, before=1, after=1)[:, 0].tolist() == [100, 100, 101]
    assert pack.window("action", 3, before=1, after=2)[:, 0].tolist() == [102, 103, 103, 103]
    assert pack.window("state", 4, before=1, after=0).tolist() == [[200] * 4, [200] * 4]
    assert pack.window("points", 6, before=1, after=1)[:, 0, 0].tolist() == [201, 202, 202]


def test_a_pack_is_replaced_as_a_whole(tmp_path: Path) -> None:
    Pack.write(tmp_path / "pack", [frames(1, 4)])
    with pytest.raises(ValueError, match="render again"):
        Pack.write(tmp_path / "pack", [frames(1, 4), frames(2, 4, points=False)])
    assert len(Pack(tmp_path / "pack")) == 4, "what was there is kept"
    assert len(Pack.write(tmp_path / "pack", [replace(frames(3, 5), layout=ActionLayout())])) == 5
    assert Pack(tmp_path / "pack").action_names == ActionLayout().names
    with pytest.raises(FileNotFoundError, match="no pack"):
        Pack(tmp_path)
    with pytest.raises(ValueError, match="no demonstration"):
        Pack.write(tmp_path / "none", [])


def test_a_folder_of_something_else_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(FileExistsError, match="something other than a pack"):
        Pack.write(tmp_path, [frames(1, 4)])
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
    (tmp_path / "new").mkdir()
    assert len(Pack.write(tmp_path / "new", [frames(1, 4)])) == 4


def test_a_pack_pickles_as_the_name_of_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the workers of a data loader get it."""
    monkeypatch.chdir(tmp_path)
    pack = Pack.write("pack", [frames(1, 4000)])
    sent = pickle.dumps(pack)
    assert len(sent) < 1000
    monkeypatch.chdir("/")
    np.testing.assert_array_equal(pickle.loads(sent).arrays["state"], pack.arrays["state"])


@pytest.mark.parametrize(
    ("name", "frame", "before", "after", "error", "message"),
    [
        ("action", -1, 0, 0, IndexError, "frames 0 to 6"),
        ("action", 7, 0, 0, IndexError, "No frame 7"),
        ("action", 10**9, 0, 0, IndexError, "frames 0 to 6"),
        ("action", 0, -1, 0, ValueError, "before is -1"),
        ("action", 0, 0, -2, ValueError, "after is -2"),
        ("action", 0, 10**9, 0, ValueError, "before is 1000000000"),
        ("action", 1.5, 0, 0, TypeError, "integer"),
        ("actions", 0, 0, 0, KeyError, "Did you mean 'action'"),
    ],
)
def test_windows_that_are_none_are_refused(
    tmp_path: Path, name: str, frame: Any, before: int, after: int, error: type[Exception], message: str
) -> None:
    pack = Pack.write(tmp_path / "pack", [frames(1, 4), frames(2, 3)])
    with pytest.raises(error, match=message):
        pack.window(name, frame, before=before, after=after)


def test_a_pack_holds_phase_and_joint_velocity(tmp_path: Path) -> None:
    pack = Pack.write(tmp_path / "pack", [frames(1, 4), frames(2, 3)])
    assert pack.arrays["phase"].tolist() == [1] * 4 + [2] * 3
    assert pack.window("dq", 6, before=1, after=0)[:, 0].tolist() == [201, 202]
    assert pack.arrays["gate"].dtype == bool
    assert pack.arrays["points"].dtype == np.float16


def test_a_pack_that_holds_something_else_is_refused_and_nothing_hangs(tmp_path: Path) -> None:
    folder = tmp_path / "pack"

    def fifo(path: Path) -> None:
        path.unlink()
        os.mkfifo(path)

    for name, spoil in (
        ("state.npy", fifo),
        ("state.npy", Path.unlink),
        ("state.npy", lambda path: path.write_bytes(path.read_bytes()[:-8])),
        ("state.npy", lambda path: np.save(path, np.zeros((3, 1)))),
        ("action.npy", lambda path: np.save(path, np.array(["a", {}], dtype=object), allow_pickle=True)),
        ("episode_ends.npy", lambda path: np.save(path, np.array([4, 2]))),
        ("episode_ends.npy", fifo),
        ("pack.json", fifo),
        ("pack.json", lambda path: path.write_text("[" * 9999)),
        ("pack.json", lambda path: path.write_text('{"arrays": ["../../x"], "action_names": []}')),
        ("pack.json", lambda path: path.write_text('{"arrays": 3, "action_names": []}')),
    ):
        Pack.write(folder, [frames(1, 4)])
        spoil(folder / name)
        with pytest.raises(DamagedFileError, match=name):
            Pack(folder)
        shutil.rmtree(folder)
