"""LeRobotDataset v3.0 without LeRobot: parquet, one row group an episode, and one MP4 a camera and episode."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynaforge.demos.exporters.frames import STATE_NAMES, Frames
from dynaforge.tasks import Task

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
CHUNK = 1000  # files a folder
KEYFRAME_EVERY = 2  # frames: learners jump to any of them
INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
STATISTICS: dict[str, Callable[..., Any]] = {"min": np.min, "max": np.max, "mean": np.mean, "std": np.std}
QUANTILES = (1, 10, 50, 90, 99)


@dataclass(slots=True)
class _Written:
    """What was written so far."""

    features: dict[str, dict[str, Any]] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    columns: dict[str, list[NDArray[Any]]] = field(default_factory=dict)
    pictures: dict[str, list[NDArray[Any]]] = field(default_factory=dict)
    frames: int = 0


def write(folder: Path, task: Task, episodes: Iterable[Frames]) -> int:
    """Write `meta/`, `data/` and `videos/`; returns the number of demonstrations.

    Raises:
        ValueError: There is none.
    """
    done, writer = _Written(), None
    data = folder / DATA.format(chunk_index=0, file_index=0)
    data.parent.mkdir(parents=True)
    try:
        for episode in episodes:
            if not done.rows:
                done.features = _features(episode)
            table = _table(episode, done)
            writer = writer or pq.ParquetWriter(data, table.schema, compression="snappy")
            writer.write_table(table)
            _add(folder, episode, done, _sentence(task))
    finally:
        if writer is not None:
            writer.close()
    if not done.rows:
        raise ValueError("There is no demonstration to export.")
    _write_meta(folder, task, done)
    return len(done.rows)


def _sentence(task: Task) -> str:
    return f"{task.skill}: {task.motion}"


def _features(episode: Frames) -> dict[str, dict[str, Any]]:
    """Describe the columns, as info.json does."""

    def vector(names: Iterable[str]) -> dict[str, Any]:
        names = list(names)
        return {"dtype": "float32", "shape": [len(names)], "names": names}

    features = {
        "observation.state": vector(STATE_NAMES),
        "observation.environment_state": vector(episode.object_names),
        "action": vector(episode.action_names),
        "next.reward": {"dtype": "float32", "shape": [1], "names": None},
        "next.done": {"dtype": "bool", "shape": [1], "names": None},
        "next.success": {"dtype": "bool", "shape": [1], "names": None},
    }
    for camera, film in episode.images.items():
        _, height, width, _ = film.shape
        features[f"observation.images.{camera}"] = {
            "dtype": "video", "shape": [height, width, 3], "names": ["height", "width", "channels"],
            "info": {
                "video.height": height, "video.width": width, "video.codec": "h264", "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False, "video.fps": episode.fps, "video.channels": 3, "has_audio": False,
            },
        }  # fmt: skip
    for name in INDICES:
        kind = "float32" if name == "timestamp" else "int64"
        features[name] = {"dtype": kind, "shape": [1], "names": None}
    return features


def _columns(episode: Frames, done: _Written) -> dict[str, NDArray[Any]]:
    n = len(episode)
    steps, last = np.arange(n), np.arange(n) == n - 1
    return {
        "observation.state": episode.state,
        "observation.environment_state": episode.object_state,
        "action": episode.actions,
        "next.reward": episode.rewards,
        "next.done": last,
        "next.success": last & episode.success,
        "timestamp": (steps / episode.fps).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full(n, len(done.rows)),
        "index": done.frames + steps,
        "task_index": np.zeros(n, dtype=np.int64),
    }


def _table(episode: Frames, done: _Written) -> pa.Table:
    columns = _columns(episode, done)
    for name, column in columns.items():
        done.columns.setdefault(name, []).append(column)
    arrays, hf = {}, {}
    for name, column in columns.items():
        kind = done.features[name]["dtype"]
        if column.ndim == 1:
            arrays[name], hf[name] = pa.array(column), {"dtype": kind, "_type": "Value"}
        else:
            flat = pa.array(np.ascontiguousarray(column).ravel())
            arrays[name] = pa.FixedSizeListArray.from_arrays(flat, column.shape[1])
            hf[name] = {"feature": {"dtype": kind, "_type": "Value"}, "length": column.shape[1], "_type": "Sequence"}
    about = json.dumps({"info": {"features": hf}})
    return pa.table(arrays).replace_schema_metadata({"huggingface": about})


def _add(folder: Path, episode: Frames, done: _Written, sentence: str) -> None:
    """Write the films of an episode and note its row of meta/episodes."""
    k, n = len(done.rows), len(episode)
    chunk, file = divmod(k, CHUNK)
    row: dict[str, Any] = {
        "episode_index": k, "tasks": [sentence], "length": n, "data/chunk_index": 0, "data/file_index": 0,
        "dataset_from_index": done.frames, "dataset_to_index": done.frames + n,
    }  # fmt: skip
    for name in done.columns:
        row |= {f"stats/{name}/{key}": value for key, value in _statistics(done.columns[name][-1]).items()}
    for camera, film in episode.images.items():
        key = f"observation.images.{camera}"
        path = folder / VIDEO.format(video_key=key, chunk_index=chunk, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_film(path, film, episode.fps)
        where = {"chunk_index": chunk, "file_index": file, "from_timestamp": 0.0, "to_timestamp": n / episode.fps}
        row |= {f"videos/{key}/{name}": value for name, value in where.items()}
        pixels = film[:: max(1, n // 8), ::4, ::4]
        done.pictures.setdefault(key, []).append(pixels)
        row |= {f"stats/{key}/{name}": value for name, value in _picture_statistics([pixels]).items()}
    done.rows.append(row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0})
    done.frames += n


def _write_film(path: Path, film: NDArray[np.uint8], fps: int) -> None:
    with av.open(str(path), "w") as container:
        options = {"g": str(KEYFRAME_EVERY), "crf": "23"}
        stream = container.add_stream("libx264", rate=fps, options=options)
        stream.height, stream.width, stream.pix_fmt = film.shape[1], film.shape[2], "yuv420p"
        for picture in film:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def _statistics(column: NDArray[Any]) -> dict[str, list[float]]:
    rows = np.asarray(column, dtype=np.float64).reshape(len(column), -1)
    found = {name: measure(rows, axis=0).tolist() for name, measure in STATISTICS.items()}
    found |= {f"q{q:02d}": np.percentile(rows, q, axis=0).tolist() for q in QUANTILES}
    return found | {"count": [len(rows)]}


def _picture_statistics(films: list[NDArray[np.uint8]]) -> dict[str, Any]:
    """Statistics of each channel within [0, 1], shaped (3, 1, 1), of some pixels of some pictures."""
    pixels = np.concatenate([film.reshape(-1, 3) for film in films]) / 255.0
    found: dict[str, Any] = {
        name: [[[value]] for value in values] for name, values in _statistics(pixels).items() if name != "count"
    }
    return found | {"count": [sum(len(film) for film in films)]}


def _write_meta(folder: Path, task: Task, done: _Written) -> None:
    stats: dict[str, Any] = {name: _statistics(np.concatenate(parts)) for name, parts in done.columns.items()}
    stats |= {name: _picture_statistics(parts) for name, parts in done.pictures.items()}
    info = {
        "codebase_version": VERSION, "robot_type": "franka", "total_episodes": len(done.rows),
        "total_frames": done.frames, "total_tasks": 1, "chunks_size": CHUNK, "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200, "fps": task.scene.fps, "splits": {"train": f"0:{len(done.rows)}"},
        "data_path": DATA, "video_path": VIDEO if done.pictures else None, "features": done.features,
    }  # fmt: skip
    meta = folder / "meta"
    (folder / EPISODES).parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(done.rows), folder / EPISODES)
    pd.DataFrame({"task_index": [0]}, index=pd.Index([_sentence(task)], name="task")).to_parquet(meta / "tasks.parquet")
    (meta / "stats.json").write_text(json.dumps(stats, indent=1))
    (meta / "info.json").write_text(json.dumps(info, indent=1))
