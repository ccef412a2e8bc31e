"""Every format is read back by those who read it: robomimic, zarr, Minari; LeRobot's files by pandas and PyAV."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.exporters import FORMATS, Frames, exporter, read_frames
from dynaforge.demos.observations import ObservationFolder
from dynaforge.tasks import get_task
from dynaforge.tasks.action import ActionLayout, without_jumps

CAN = get_task("can")
FPS = 30


def test_frames_hold_what_was_recorded(episodes: list[Frames]) -> None:
    frames = episodes[0]
    steps = frames.episode.steps
    np.testing.assert_allclose(frames.state[:, :3], steps["ee_position"], atol=1e-6)
    np.testing.assert_allclose(frames.state[:, 8:], steps["q"], atol=1e-6)
    assert frames.object_state.shape == (len(frames), 13)
    assert frames.object_names[0] == "can_angular_velocity_x"
    assert len(frames.action_names) == frames.actions.shape[1] == 9
    assert np.abs((frames.actions[:, 3:7] * frames.robot["ee_quat_wxyz"]).sum(axis=1)).min() > 0.5


def test_quaternions_do_not_jump() -> None:
    quat = np.array(((0.1, 0.99, 0, 0), (-0.1, -0.99, 0, 0), (-0.2, -0.97, 0, 0), (0.3, 0.95, 0, 0)))
    np.testing.assert_array_equal(np.sign(without_jumps(quat)[:, 1]), (1, 1, 1, 1))
    np.testing.assert_array_equal(np.abs(without_jumps(quat)), np.abs(quat))


def test_robomimic(episodes: list[Frames], tmp_path: Path) -> None:
    from robomimic.utils import dataset  # `make` installs it; without it this fails rather than goes unseen

    assert exporter("robomimic")(tmp_path, CAN, episodes) == 3
    keys = ("ee_position", "privileged_can_position", "front_image")
    reader = dataset.SequenceDataset(
        str(tmp_path / "demos.hdf5"),
        obs_keys=keys,
        dataset_keys=("actions", "rewards", "dones"),
        seq_length=4,
        frame_stack=2,
        load_next_obs=False,
        filter_by_attribute="train",
        hdf5_cache_mode=None,
    )
    assert len(reader) == sum(map(len, episodes[:2])), "the last one is for validation"
    first = reader[5]
    np.testing.assert_allclose(
        first["obs"]["privileged_can_position"], episodes[0].objects["can_position"][4:9], atol=1e-6
    )
    np.testing.assert_array_equal(first["obs"]["front_image"], episodes[0].images["front"][4:9])
    import h5py

    with h5py.File(tmp_path / "demos.hdf5") as file:
        scaled = np.asarray(file["data/demo_1/actions"])
        low, high = file["data"].attrs["action_low"], file["data"].attrs["action_high"]
        assert np.abs(scaled).max() <= 1.0 + 1e-6
        np.testing.assert_allclose(low + (scaled + 1) / 2 * (high - low), episodes[1].actions, atol=1e-5)
        assert json.loads(file["data"].attrs["env_args"])["env_name"] == "DynaForge/CanTask-v0"


def test_robomimic_as_its_offline_learners_read_it_by_default(episodes: list[Frames], tmp_path: Path) -> None:
    """With next_obs; from a single demonstration, which both masks name."""
    from robomimic.utils import dataset

    exporter("robomimic")(tmp_path, CAN, [episodes[0]])
    keys = ("ee_position", "privileged_can_position", "front_image", "front_depth", "points")
    for split in (None, "train", "valid"):
        reader = dataset.SequenceDataset(
            str(tmp_path / "demos.hdf5"),
            obs_keys=keys,
            dataset_keys=("actions", "dones", "phase", "gate", "contact"),
            filter_by_attribute=split,
        )
        assert len(reader) == len(episodes[0])
        first, last = reader[3], reader[len(reader) - 1]
        after = reader[4]
        for key in keys:
            np.testing.assert_array_equal(first["next_obs"][key], after["obs"][key])
            np.testing.assert_array_equal(last["next_obs"][key], last["obs"][key])
        assert first["contact"].tolist() == [episodes[0].contact[3].tolist()]
        assert last["dones"] == 1
    np.testing.assert_allclose(first["obs"]["front_depth"][0, ..., 0], episodes[0].depths["front"][3] * 1e-4, atol=1e-7)


def test_robomimic_names_the_env_of_its_actions_the_phases_and_the_words(
    episodes: list[Frames], tmp_path: Path
) -> None:
    import h5py

    exporter("robomimic")(tmp_path, CAN, episodes)
    with h5py.File(tmp_path / "demos.hdf5") as file:
        about = dict(file["data"].attrs)
        demo = file["data/demo_0"]
        told = json.loads(demo.attrs["ep_meta"])["lang"]
        assert sum(map(len, (file["mask/train"], file["mask/valid"]))) == 3
        assert json.loads(about["phase_names"])[demo["phase"][0]] == "pregrasp"
        assert json.loads(about["observation_names"])["privileged_can_quat_wxyz"] == ["w", "x", "y", "z"]
    assert told == about["instruction"] == "pick up the rolling can"
    arguments = json.loads(about["env_args"])
    env = gym.make(arguments["env_name"], **arguments["env_kwargs"])
    assert env.unwrapped.action_mode == "ee"  # type: ignore[attr-defined]
    env.close()


def test_the_truth_about_objects_is_left_out_beside_pictures_unless_asked_for(
    recorded: DemonstrationDataset, tmp_path: Path
) -> None:
    """And beside points; where there is nothing to see by, it is what low-dimensional learners learn from."""
    h5py, zarr = pytest.importorskip("h5py"), pytest.importorskip("zarr")
    seen = ObservationFolder(recorded.path / "observations")

    def names(name: str, **options: Any) -> set[str]:
        folder = tmp_path / f"{name}{len(list(tmp_path.iterdir()))}"
        exporter(name)(folder, CAN, islice(read_frames(recorded, fps=FPS, failures=True, **options), 1))
        if name == "robomimic":
            with h5py.File(folder / "demos.hdf5") as file:
                return set(file["data/demo_0/obs"])
        if name == "dp3-zarr":
            return set(zarr.open_group(str(folder / "demos.zarr"), mode="r")["data"])
        return set(json.loads((folder / "meta/info.json").read_text())["features"])

    for name in ("robomimic", "dp3-zarr", "lerobot"):
        hidden, asked = names(name, observations=seen), names(name, observations=seen, privileged=True)
        told = asked - hidden
        assert told
        assert all("privileged" in key for key in told), told
    low = names("robomimic")
    assert {"ee_position", "can_position", "privileged_can_position"} <= low
    assert "observation.environment_state" in names("lerobot")


def test_dp3_zarr(episodes: list[Frames], tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    assert exporter("dp3-zarr")(tmp_path, CAN, episodes) == 3
    root = zarr.open_group(str(tmp_path / "demos.zarr"), mode="r")
    assert root.metadata.zarr_format == 2
    ends = root["meta/episode_ends"][:]
    np.testing.assert_array_equal(ends, np.cumsum([len(e) for e in episodes]))
    assert ends.dtype == np.int64
    np.testing.assert_array_equal(root["data/point_cloud"][ends[0] : ends[1]], episodes[1].points)
    np.testing.assert_array_equal(root["data/state"][: ends[0]], episodes[0].state)
    np.testing.assert_array_equal(root["data/action"][ends[1] :], episodes[2].actions)
    assert root["data/point_cloud"].dtype == np.float32
    np.testing.assert_array_equal(root["data/img"][: ends[0]], episodes[0].images["front"])
    np.testing.assert_allclose(root["data/depth"][: ends[0]], episodes[0].depths["front"] * 1e-4, atol=1e-7)
    np.testing.assert_array_equal(root["data/phase"][: ends[0]], episodes[0].phase)
    np.testing.assert_array_equal(root["data/contact"][ends[1] :], episodes[2].contact)
    assert root["data/action"].attrs["names"] == list(episodes[0].action_names)
    assert root.attrs["instruction"] == CAN.instruction


def test_dp3_zarr_says_that_points_are_needed(episodes: list[Frames], tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    with pytest.raises(ValueError, match="dynaforge render FOLDER --points"):
        exporter("dp3-zarr")(tmp_path, CAN, [replace(episodes[0], points=None)])


@pytest.mark.filterwarnings("ignore")
def test_minari(episodes: list[Frames], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    assert exporter("minari")(tmp_path, CAN, episodes) == 3
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = minari.load_dataset("dynaforge/can/demonstrations-v0")
    assert dataset.total_episodes == 3
    for episode, frames in zip(dataset.iterate_episodes(), episodes, strict=True):
        assert len(episode.observations) == len(frames) + 1
        rows = np.concatenate((frames.state, frames.object_state), axis=1)
        np.testing.assert_array_equal(episode.observations[:-1], rows)
        # One more control step: all is close to what it was, quaternions have not changed their sign.
        np.testing.assert_allclose(episode.observations[-1][:15], rows[-1][:15], atol=0.2)
        np.testing.assert_array_equal(episode.actions, frames.actions)
        assert episode.terminations.tolist() == [False] * (len(frames) - 1) + [True]
        np.testing.assert_array_equal(episode.infos["phase"][:-1], frames.phase)
        np.testing.assert_array_equal(episode.infos["dq"][:-1], frames.robot["dq"])
        assert {len(column) for column in episode.infos.values()} == {len(frames) + 1}
    metadata = dataset.storage.metadata
    assert len(metadata["observation_names"]) == dataset.observation_space.shape[0]
    assert metadata["instruction"] == CAN.instruction
    joint = ActionLayout("joint")
    asked = replace(episodes[0], layout=joint, actions=joint.of_steps(episodes[0].episode.steps).astype(np.float32))
    for kind, frames in (("ee", episodes), ("joint", [asked])):
        if kind == "joint":
            monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / kind))
            exporter("minari")(tmp_path / kind, CAN, frames)
        env = minari.load_dataset("dynaforge/can/demonstrations-v0").recover_environment()
        assert (env.spec.id, env.unwrapped.action_mode) == ("DynaForge/CanTask-v0", kind)
        assert all(env.action_space.contains(row) for row in frames[0].actions)
        env.close()


@pytest.fixture(scope="module")
def lerobot(episodes: list[Frames], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    pytest.importorskip("av")
    folder = tmp_path_factory.mktemp("lerobot")
    assert exporter("lerobot")(folder, CAN, episodes) == 3
    return folder


def test_lerobot_tables(episodes: list[Frames], lerobot: Path) -> None:
    pandas, parquet = pytest.importorskip("pandas"), pytest.importorskip("pyarrow.parquet")
    info = json.loads((lerobot / "meta/info.json").read_text())
    total = sum(map(len, episodes))
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", FPS, 3)
    assert (info["total_frames"], info["splits"]) == (total, {"train": "0:3"})
    path = lerobot / info["data_path"].format(chunk_index=0, file_index=0)
    assert parquet.ParquetFile(path).num_row_groups == 3, "one row group an episode"
    table = pandas.read_parquet(path)
    assert table["index"].tolist() == list(range(total))
    assert {*table.columns} == {name for name, about in info["features"].items() if about["dtype"] != "video"}
    second = table[table["episode_index"] == 1]
    np.testing.assert_array_equal(np.stack(second["action"]), episodes[1].actions)
    np.testing.assert_allclose(second["timestamp"], np.arange(len(second)) / FPS, atol=1e-5)
    for name, about in info["features"].items():
        if about["dtype"] not in ("video", "image"):
            assert np.size(table[name].iloc[0]) == about["shape"][0], name
    tasks = pandas.read_parquet(lerobot / "meta/tasks.parquet")
    assert tasks.index.name == "task"
    assert tasks["task_index"].tolist() == [0]
    rows = pandas.read_parquet(lerobot / "meta/episodes/chunk-000/file-000.parquet")
    assert rows["dataset_to_index"].tolist() == np.cumsum([len(e) for e in episodes]).tolist()
    assert rows["length"].tolist() == [len(e) for e in episodes]
    hf = json.loads(parquet.read_schema(path).metadata[b"huggingface"])["info"]["features"]
    assert {*hf} == {*table.columns}


def test_lerobot_films_and_statistics(episodes: list[Frames], lerobot: Path) -> None:
    av, pandas = pytest.importorskip("av"), pytest.importorskip("pandas")
    info = json.loads((lerobot / "meta/info.json").read_text())
    rows = pandas.read_parquet(lerobot / "meta/episodes/chunk-000/file-000.parquet")
    key = "observation.images.front"
    for frames, (_, row) in zip(episodes, rows.iterrows(), strict=True):
        path = info["video_path"].format(
            video_key=key, chunk_index=row[f"videos/{key}/chunk_index"], file_index=row[f"videos/{key}/file_index"]
        )
        with av.open(str(lerobot / path)) as film:
            pictures = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert len(pictures) == len(frames)
        assert row[f"videos/{key}/to_timestamp"] == pytest.approx(len(frames) / FPS)
        assert np.abs(pictures[7].astype(float) - frames.images["front"][7]).mean() < 6.0
    stats = json.loads((lerobot / "meta/stats.json").read_text())
    actions = np.concatenate([e.actions for e in episodes]).astype(float)
    np.testing.assert_allclose(stats["action"]["mean"], actions.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(stats["action"]["q50"], np.percentile(actions, 50, axis=0), atol=1e-9)
    assert np.shape(stats[key]["mean"]) == (3, 1, 1)
    assert 0.0 <= np.min(stats[key]["min"]) <= np.max(stats[key]["max"]) <= 1.0


def test_lerobot_pads_odd_pictures_and_keeps_every_pixel_of_them(episodes: list[Frames], tmp_path: Path) -> None:
    """H.264 knows even sizes only."""
    av = pytest.importorskip("av")
    film = episodes[0].images["front"][:, :23, :31]
    odd = replace(episodes[0], images={"front": film}, depths={"front": episodes[0].depths["front"][:, :23, :31]})
    exporter("lerobot")(tmp_path, CAN, [odd])
    features = json.loads((tmp_path / "meta/info.json").read_text())["features"]
    assert features["observation.images.front"]["shape"] == [24, 32, 3]
    assert features["observation.images.front_depth"]["shape"] == [24, 32, 1]
    (path,) = tmp_path.rglob("*.mp4")
    with av.open(str(path)) as stored:
        pictures = np.stack([frame.to_ndarray(format="rgb24") for frame in stored.decode(video=0)])
    assert pictures.shape[1:3] == (24, 32)
    assert np.abs(pictures[:, :23, :31].astype(float) - film).mean() < 6.0


@pytest.mark.parametrize("name", FORMATS)
def test_an_empty_dataset_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no demonstration to export"):
        exporter(name)(tmp_path, CAN, islice([], 0))


def test_an_unknown_format_is_named() -> None:
    with pytest.raises(ValueError, match="there are lerobot, robomimic, dp3-zarr, minari"):
        exporter("rlds")
