"""LeRobot's own readers on what is exported for them; needs the environments that `make test-lerobot` makes."""

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
@pytest.mark.parametrize("variable", ["LEROBOT_PYTHON", "LEROBOT_NEWEST_PYTHON"])
def test_lerobot_reads_what_was_written(episodes: list[Frames], tmp_path: Path, variable: str) -> None:
    python = os.environ.get(variable, "")
    if not python:
        pytest.skip(f"{variable} names no interpreter with lerobot; `make test-lerobot` makes one, where it can")
    exporter("lerobot")(tmp_path, get_task("can"), episodes)
    offline = os.environ | {"HF_HUB_OFFLINE": "1", "PYTHONPATH": ""}
    done = subprocess.run(
        [python, str(READER), str(tmp_path)], capture_output=True, text=True, env=offline, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    seen = json.loads(done.stdout.splitlines()[-1])
    assert (seen["episodes"], seen["fps"]) == (len(episodes), 30)
    assert seen["task"] == "pick up the rolling can"
    phases = [get_task("can").phases[k].name for e in episodes for k in e.phase]
    assert seen["phases"] == phases
    assert seen["phases_told"] in (phases, [None] * len(phases))
    actions = np.concatenate([e.actions for e in episodes])
    np.testing.assert_array_equal(np.array(seen["actions"], dtype=np.float32), actions)
    np.testing.assert_allclose(seen["states"], np.concatenate([e.state for e in episodes]), atol=1e-7)
    np.testing.assert_allclose(seen["velocities"], np.concatenate([e.robot["dq"] for e in episodes]), atol=1e-6)
    np.testing.assert_array_equal(seen["contacts"], np.concatenate([e.contact for e in episodes]))
    later = np.concatenate([np.vstack((e.actions[1:], e.actions[-1:])) for e in episodes])  # padded at the end
    np.testing.assert_array_equal(np.array(seen["next_actions"], dtype=np.float32), later)
    films = np.concatenate([e.images["front"].mean(axis=(1, 2, 3)) / 255 for e in episodes])
    np.testing.assert_allclose(seen["brightness"]["observation.images.front"], films, atol=0.02)
    depths = np.concatenate([np.round(e.depths["front"] * 0.1).mean(axis=(1, 2)) for e in episodes])  # millimetres
    np.testing.assert_allclose(seen["brightness"]["observation.images.front_depth"], depths, rtol=1e-4)
    np.testing.assert_allclose(seen["mean_action"], actions.astype(float).mean(axis=0), atol=1e-6)
