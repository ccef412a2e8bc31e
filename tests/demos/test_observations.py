"""What is rendered of an episode: the views of its own states, stored so that damage is noticed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynaforge.demos import DamagedFileError, Episode
from dynaforge.demos.observation_file import read_observations, write_observations
from dynaforge.demos.observations import (
    ObservationFolder,
    ObservationRenderer,
    ObservationSettings,
    farthest_points,
    standard_cameras,
)
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import PlannerOnly
from dynaforge.registration import ENV_NAMES
from dynaforge.sim.camera import Camera
from dynaforge.tasks import get_task

SMALL = (64, 48)


def episode_of(name: str, *, steps: int) -> Episode:
    """The first steps of an episode of the planner."""
    env = ResidualEnv(name)
    whole = PlannerOnly().attempt(env, next(env.task.conditions.stream("val", n_strata=8)))
    env.close()
    return replace(whole, steps={key: column[:steps] for key, column in whole.steps.items()})


def settings(name: str, *cameras: str, images: bool = True, points: int = 0) -> ObservationSettings:
    known = standard_cameras(get_task(name))
    return ObservationSettings(tuple(replace(known[c], size=SMALL) for c in cameras), images, points)


@pytest.mark.parametrize("name", ENV_NAMES)
def test_every_task_can_be_seen(name: str) -> None:
    episode = episode_of(name, steps=3)
    renderer = ObservationRenderer(get_task(name), settings(name, "front", "side", "wrist"))
    arrays = renderer.render(episode)
    things = renderer.names()
    renderer.close()
    for camera in ("front", "side", "wrist"):
        assert arrays[f"{camera}/rgb"].shape == (3, *SMALL[::-1], 3)
        assert arrays[f"{camera}/depth"].shape == arrays[f"{camera}/segmentation"].shape == (3, *SMALL[::-1])
        np.testing.assert_allclose(np.linalg.norm(arrays[f"{camera}/quat_wxyz"], axis=1), 1.0)
    seen = {things[k] for c in ("front", "side") for k in np.unique(arrays[f"{c}/segmentation"]) if k >= 0}
    assert {"robot", "table", get_task(name).manipulated} <= seen


def test_points_lie_in_the_workspace_and_are_as_many_as_asked_for() -> None:
    pytest.importorskip("fpsample")
    wanted = settings("can", "front", "wrist", images=False, points=128)
    renderer = ObservationRenderer(get_task("can"), wanted)
    arrays = renderer.render(episode_of("can", steps=4))
    renderer.close()
    assert arrays["points"].shape == arrays["point_colors"].shape == (4, 128, 3)
    low, high = np.array(wanted.workspace)
    assert (arrays["points"] > low - 0.001).all()
    assert (arrays["points"] < high + 0.001).all()
    assert not any("rgb" in name for name in arrays)


def test_steps_at_which_nothing_is_seen_have_zeros() -> None:
    """A column over the can's last position, seen from above, into which neither can nor hand has come at first."""
    pytest.importorskip("fpsample")
    episode = episode_of("can", steps=14)
    x, y, z = episode.steps["object/can/position"][-1]
    above = Camera("above", (x, y, 0.5), (x, y, 0.0), up=(1.0, 0.0, 0.0), size=SMALL)
    column = ((x - 0.01, y - 0.01, 0.002), (x + 0.01, y + 0.01, 2.0 * z + 0.01))
    renderer = ObservationRenderer(get_task("can"), ObservationSettings((above,), False, 16, column))
    seen = renderer.render(episode)["points"]
    renderer.close()
    assert not seen[0].any()
    assert seen[-1].all()
    nowhere = ObservationRenderer(get_task("can"), ObservationSettings((above,), False, 16, ((5, 5, 5), (6, 6, 6))))
    with pytest.raises(ValueError, match="No camera ever sees a point"):
        nowhere.render(replace(episode, steps={name: rows[:2] for name, rows in episode.steps.items()}))
    nowhere.close()


def test_farthest_points_keep_their_distance() -> None:
    pytest.importorskip("fpsample")
    line = np.zeros((101, 3))
    line[:, 0] = np.linspace(0.0, 1.0, 101)
    chosen = np.sort(line[farthest_points(line, 5), 0])
    np.testing.assert_allclose(chosen, (0.0, 0.25, 0.5, 0.75, 1.0), atol=0.011)
    np.testing.assert_array_equal(farthest_points(line[:2], 5), (0, 1, 0, 1, 0))
    with pytest.raises(ValueError, match="no point"):
        farthest_points(line[:0], 5)


def test_a_replay_that_leaves_the_recording_is_not_rendered() -> None:
    episode = episode_of("can", steps=6)
    steps = dict(episode.steps)
    steps["q"] = steps["q"].copy()
    steps["q"][3, 0] += 1e-9
    renderer = ObservationRenderer(get_task("can"), settings("can", "front"))
    with pytest.raises(ValueError, match="q differs from step 3 on"):
        renderer.render(replace(episode, steps=steps))
    renderer.close()


def test_files_give_back_what_was_written_and_notice_damage(tmp_path: Path) -> None:
    episode = episode_of("can", steps=2)
    renderer = ObservationRenderer(get_task("can"), settings("can", "front"))
    arrays, path = renderer.render(episode), tmp_path / "e.h5"
    write_observations(path, episode, arrays, names=renderer.names(), settings="x")
    renderer.close()
    back = read_observations(path)
    assert sorted(back) == sorted(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].dtype == array.dtype
    assert read_observations(path, of=episode).keys() == arrays.keys()
    with pytest.raises(ValueError, match="rendered from another recording"):
        read_observations(path, of=episode_of("can", steps=3))
    assert read_observations(path, settings="x").keys() == arrays.keys()
    with pytest.raises(DamagedFileError, match=r"other settings than settings\.json holds.*render again"):
        read_observations(path, settings="y")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(DamagedFileError, match=r"e\.h5"):
        read_observations(path)


def test_a_folder_keeps_to_its_settings(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="dynaforge render"):
        ObservationFolder(tmp_path)
    wanted = settings("can", "front", "wrist", points=64)
    ObservationFolder(tmp_path, wanted)
    assert ObservationFolder(tmp_path).settings == wanted
    with pytest.raises(ValueError, match="other settings"):
        ObservationFolder(tmp_path, settings("can", "front"))
    for damaged in ("{}", "[]", "{"):
        (tmp_path / "settings.json").write_text(damaged)
        with pytest.raises(DamagedFileError, match=r"settings\.json is damaged: it holds no settings"):
            ObservationFolder(tmp_path)


@pytest.mark.parametrize(("cameras", "kind"), [((), {}), (("front", "front"), {}), (("front",), {"images": False})])
def test_empty_settings_are_refused(cameras: tuple[str, ...], kind: dict[str, bool]) -> None:
    with pytest.raises(ValueError, match=r"at least one|Nothing to render"):
        settings("can", *cameras, **kind)


@pytest.mark.parametrize(
    "name", ["../../x", "a/b", "/x", "..", ".x", "a\0b", "a\nb", "", "points", "x" * 300, 7, None, ["a"]]
)
def test_a_camera_whose_name_is_no_part_of_a_file_name_is_refused_where_settings_are_read(
    tmp_path: Path, name: object
) -> None:
    """Settings come with a downloaded dataset; exports name files by their cameras."""
    ObservationFolder(tmp_path, settings("can", "front"))
    stored = json.loads((tmp_path / "settings.json").read_text())
    stored["cameras"][0]["name"] = name
    (tmp_path / "settings.json").write_text(json.dumps(stored))
    with pytest.raises(DamagedFileError, match=r"no name for a camera|Camera: name is"):
        ObservationFolder(tmp_path)
    with pytest.raises(ValueError, match=r"no name for a camera|Camera: name is"):
        ObservationSettings((replace(standard_cameras(get_task("can"))["front"], name=name),))  # type: ignore[arg-type]


@pytest.mark.parametrize("m", [2, 3, 9, 31, 32, 33, 200])
def test_of_any_number_of_points_some_far_apart_are_chosen(m: int) -> None:
    points = np.random.default_rng(0).normal(size=(m, 3))
    for n in {1, 2, m // 2, m - 1, m, m + 5} - {0}:
        chosen = farthest_points(points, n)
        assert len(chosen) == n
        assert len(set(chosen.tolist())) == min(n, m)
