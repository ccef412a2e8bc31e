"""LeRobotDataset v3.0 without LeRobot: parquet, one row group per episode, one MP4 per camera and episode."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image

from dynaforge.demos.exporters.frames import Frames
from dynaforge.demos.exporters.lerobot_features import Row, even, features, truth_name
from dynaforge.demos.exporters.statistics import Statistics, statistics
from dynaforge.tasks import Task

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
CHUNK = 1000  # files per folder
KEYFRAME_EVERY = 2  # frames, since learners seek to any of them
ROWS = 200  # of meta/episodes, kept in memory until they are written
NO_PHASE = "none"
PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write `meta/`, `data/` and `videos/` and return the number of demonstrations.

    Args:
        folder: Where to write.
        task: The task.
        episodes: What to write.

    Raises:
        ValueError: There is no demonstration.
    """
    writer = None
    try:
        for episode in episodes:
            writer = writer or _Writer(folder, task, episode)
            writer.add(episode)
            del episode  # free its memory before the next is read
    finally:
        if writer is not None:
            writer.close()
    if writer is None:
        raise ValueError("There is no demonstration to export.")
    writer.write_meta()
    return writer.episodes


class _Writer:
    """Writes episodes one by one, and keeps none of their pictures in memory.

    Args:
        folder: Folder of the dataset.
        task: The task.
        first: The first episode, from which the columns are known.
    """

    def __init__(self, folder: Path, task: Task, first: Frames) -> None:
        self._folder, self._task = folder, task
        self.features, self.n_phases = features(first), len(task.phases)
        self.episodes = self.frames = 0
        self._statistics = {name: Statistics() for name in self.features}
        self._pixels = 1  # sampled from each picture
        self._rows: list[Row] = []
        for path in (DATA.format(chunk_index=0, file_index=0), EPISODES):
            (folder / path).parent.mkdir(parents=True)
        self._data: pq.ParquetWriter | None = None
        self._metadata: pq.ParquetWriter | None = None

    def add(self, episode: Frames) -> None:
        """Write an episode: its row group, its films and its row of meta/episodes."""
        n = len(episode)
        columns = _columns(episode, self)
        table = _table(columns, episode, self.features)
        if self._data is None:
            path = self._folder / DATA.format(chunk_index=0, file_index=0)
            self._data = pq.ParquetWriter(path, table.schema, compression="snappy")
        self._data.write_table(table)
        row: Row = {
            "episode_index": self.episodes,
            "tasks": [self._task.instruction],
            "length": n,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + n,
        }
        for name, column in columns.items():
            self._statistics[name].add(column)
            row |= {f"stats/{name}/{key}": value for key, value in statistics(column).items()}
        for camera, film in episode.images.items():
            row |= self._film(f"observation.images.{camera}", film, episode.fps)
        for camera, depth in episode.depths.items():
            row |= self._pictures(f"observation.images.{camera}_depth", depth[..., None], unit=0.1)
        self._rows.append(row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0})
        self.episodes, self.frames = self.episodes + 1, self.frames + n
        if len(self._rows) >= ROWS:
            self._flush()

    def _film(self, key: str, film: NDArray[np.uint8], fps: int) -> Row:
        chunk, file = divmod(self.episodes, CHUNK)
        path = self._folder / VIDEO.format(video_key=key, chunk_index=chunk, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_film(path, film, fps)
        end = len(film) / fps
        where = {"chunk_index": chunk, "file_index": file, "from_timestamp": 0.0, "to_timestamp": end}
        row = {f"videos/{key}/{name}": value for name, value in where.items()}
        return row | self._pictures(key, film, unit=1 / 255)

    def _pictures(self, key: str, film: NDArray[Any], *, unit: float) -> Row:
        """Add a sample of the pixels to the statistics, and return those of the episode."""
        sample = film[:: max(1, len(film) // 8), ::4, ::4]
        pixels = sample.reshape(-1, sample.shape[-1]) * unit
        self._statistics[key].add(pixels)
        self._pixels = len(pixels) // len(sample)
        own = _by_channel(statistics(pixels), self._pixels)
        return {f"stats/{key}/{name}": value for name, value in own.items()}

    def _flush(self) -> None:
        if self._rows:
            table = pa.Table.from_pylist(self._rows, schema=self._metadata and self._metadata.schema)
            self._metadata = self._metadata or pq.ParquetWriter(self._folder / EPISODES, table.schema)
            self._metadata.write_table(table)
            self._rows.clear()

    def close(self) -> None:
        """Finish the tables."""
        self._flush()
        for writer in (self._data, self._metadata):
            if writer is not None:
                writer.close()

    def write_meta(self) -> None:
        """Write the description of the dataset, once all episodes are written."""
        stats: dict[str, Any] = {}
        for name, found in self._statistics.items():
            of_picture = self.features[name]["dtype"] in ("video", "image")
            stats[name] = _by_channel(found.summary(), self._pixels) if of_picture else found.summary()
        films = any(feature["dtype"] == "video" for feature in self.features.values())
        info = {
            "codebase_version": VERSION,
            "robot_type": "franka",
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": 1,
            "chunks_size": CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._task.scene.fps,
            "splits": {"train": f"0:{self.episodes}"},
            "data_path": DATA,
            "video_path": VIDEO if films else None,
            "features": self.features,
        }
        meta = self._folder / "meta"
        phases = [*(phase.name for phase in self._task.phases), NO_PHASE]
        _write_names(meta / "tasks.parquet", "task", [self._task.instruction])
        _write_names(meta / "subtasks.parquet", "subtask", phases)
        (meta / "stats.json").write_text(json.dumps(stats, indent=1))
        (meta / "info.json").write_text(json.dumps(info, indent=1))


def _columns(episode: Frames, writer: _Writer) -> dict[str, NDArray[Any]]:
    """Return the columns of numbers."""
    n = len(episode)
    steps, last = np.arange(n), np.arange(n) == n - 1
    no_phase = (episode.phase < 0) | (episode.phase > writer.n_phases)
    columns = {
        "observation.state": episode.state,
        "observation.joint_velocity": episode.robot["dq"],
        "action": episode.actions,
        "next.reward": episode.rewards,
        "next.done": last,
        "next.success": last & episode.success,
        "gate": episode.gate,
        "contact": episode.contact,
        "timestamp": (steps / episode.fps).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full(n, writer.episodes),
        "index": writer.frames + steps,
        "task_index": np.zeros(n, dtype=np.int64),
        "subtask_index": np.where(no_phase, writer.n_phases, episode.phase),
    }
    return columns | ({truth_name(episode): episode.object_state} if episode.privileged else {})


def _table(columns: Mapping[str, NDArray[Any]], episode: Frames, described: Mapping[str, Row]) -> pa.Table:
    arrays, hf_features = {}, {}
    for name, column in columns.items():
        kind = described[name]["dtype"]
        if column.ndim == 1:
            arrays[name] = pa.array(column)
            hf_features[name] = {"dtype": kind, "_type": "Value"}
        else:
            flat = pa.array(np.ascontiguousarray(column).ravel())
            arrays[name] = pa.FixedSizeListArray.from_arrays(flat, column.shape[1])
            hf_features[name] = {
                "feature": {"dtype": kind, "_type": "Value"},
                "length": column.shape[1],
                "_type": "Sequence",
            }
    for camera, depth in episode.depths.items():
        name = f"observation.images.{camera}_depth"
        arrays[name] = pa.array([{"bytes": _png(picture), "path": None} for picture in depth], PICTURE)
        hf_features[name] = {"_type": "Image"}
    metadata = json.dumps({"info": {"features": hf_features}})
    return pa.table(arrays).replace_schema_metadata({"huggingface": metadata})


def _png(picture: NDArray[np.uint16]) -> bytes:
    """Encode a depth map in whole millimetres, as LeRobot expects it."""
    buffer = io.BytesIO()
    Image.fromarray(even(np.round(picture * 0.1).astype(np.uint16))).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()


def _write_film(path: Path, film: NDArray[np.uint8], fps: int) -> None:
    height, width, _ = even(film[0]).shape
    with av.open(str(path), "w") as container:
        options = {"g": str(KEYFRAME_EVERY), "crf": "23"}
        stream = container.add_stream("libx264", rate=fps, options=options)
        stream.height, stream.width, stream.pix_fmt = height, width, "yuv420p"
        for picture in film:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(even(picture), format="rgb24")))
        container.mux(stream.encode())


def _by_channel(found: Mapping[str, list[float]], pixels: int) -> Row:
    """Shape the statistics of pixels as (C, 1, 1), and count pictures instead of pixels."""
    shaped = {name: [[[value]] for value in values] for name, values in found.items() if name != "count"}
    return {**shaped, "count": [int(found["count"][0]) // pixels]}


def _write_names(path: Path, kind: str, names: list[str]) -> None:
    """Write the table of what the indices of a kind stand for."""
    pd.DataFrame({f"{kind}_index": range(len(names))}, index=pd.Index(names, name=kind)).to_parquet(path)
