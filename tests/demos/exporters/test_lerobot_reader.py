"""LeRobot's own reader on what is exported for it; needs the environment that `make test-lerobot` makes."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from dynaforge.demos.exporters import Frames, exporter
from dynaforge.tasks import get_task

READER = Path(__file__).with_name("read_with_lerobot.py")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_lerobot_reads_what_was_written(episodes: list[Frames], tmp_path: Path) -> None:
    python = os.environ.get("LEROBOT_PYTHON", "")
    if not python:
        pytest.skip("LEROBOT_PYTHON names no interpreter with lerobot; `make test-lerobot` makes one")
    exporter("lerobot")(tmp_path, get_task("can"), episodes)
    offline = os.environ | {"HF_HUB_OFFLINE": "1", "PYTHONPATH": ""}
    done = subprocess.run(
        [python, str(READER), str(tmp_path)], capture_output=True, text=True, env=offline, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    seen = json.loads(done.stdout.splitlines()[-1])
    assert (seen["episodes"], seen["fps"]) == (len(episodes), 30)
    assert seen["task"].startswith("grasp")
    actions = np.concatenate([e.actions for e in episodes])
    np.testing.assert_array_equal(np.array(seen["actions"], dtype=np.float32), actions)
    np.testing.assert_allclose(seen["states"], np.concatenate([e.state for e in episodes]), atol=1e-7)
    later = np.concatenate([np.vstack((e.actions[1:], e.actions[-1:])) for e in episodes])  # padded at the end
    np.testing.assert_array_equal(np.array(seen["next_actions"], dtype=np.float32), later)
    films = np.concatenate([e.images["front"].mean(axis=(1, 2, 3)) / 255 for e in episodes])
    np.testing.assert_allclose(seen["brightness"]["observation.images.front"], films, atol=0.02)
    np.testing.assert_allclose(seen["mean_action"], actions.astype(float).mean(axis=0), atol=1e-6)
