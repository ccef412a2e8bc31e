"""Reads an exported LeRobot dataset with LeRobot itself, in its own environment: `python read_with_lerobot.py FOLDER`.

LeRobot pins other versions of torch and friends than this package, so `make test-lerobot` gives it an environment of
its own. What it read is printed as JSON, to be compared with what was written.
"""

import json
import sys

import pandas
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset(
    "me/demonstrations", root=sys.argv[1], delta_timestamps={"action": [0.0, 1 / 30]}, video_backend="pyav"
)
rows = [dataset[k] for k in range(len(dataset))]
cameras = [key for key in rows[0] if key.startswith("observation.images.")]
subtasks = pandas.read_parquet(f"{sys.argv[1]}/meta/subtasks.parquet").index
print(
    json.dumps(
        {
            "episodes": dataset.num_episodes,
            "fps": dataset.fps,
            "task": rows[0]["task"],
            "phases": [subtasks[int(row["subtask_index"])] for row in rows],
            "phases_told": [row.get("subtask") for row in rows],  # by versions that know subtasks
            "states": [row["observation.state"].tolist() for row in rows],
            "velocities": [row["observation.joint_velocity"].tolist() for row in rows],
            "contacts": [row["contact"].tolist() for row in rows],
            "actions": [row["action"][0].tolist() for row in rows],
            "next_actions": [row["action"][1].tolist() for row in rows],
            "brightness": {key: [float(row[key].float().mean()) for row in rows] for key in cameras},
            "mean_action": dataset.meta.stats["action"]["mean"].tolist(),
        }
    )
)
