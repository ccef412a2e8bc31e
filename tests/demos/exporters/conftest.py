"""Recordings to export."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.exporters import Frames, read_frames
from dynaforge.demos.observations import (
    ObservationFolder,
    ObservationRenderer,
    ObservationSettings,
    standard_cameras,
)
from dynaforge.generators import Goal, PlannerOnly, collect
from dynaforge.tasks import get_task

CAN = get_task("can")


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> DemonstrationDataset:
    """Three recordings of Can, with small pictures and points."""
    pytest.importorskip("fpsample")
    folder = tmp_path_factory.mktemp("data")
    dataset = DemonstrationDataset(folder, task="can", keep_failures=True)
    collect(dataset, CAN, PlannerOnly(), Goal(None, 3), workers=1)
    camera = replace(standard_cameras(CAN)["front"], size=(32, 24))
    seen = ObservationFolder(folder / "observations", ObservationSettings((camera,), points=16))
    renderer = ObservationRenderer(CAN, seen.settings)
    for episode in dataset:
        seen.write(episode, renderer.render(episode), renderer.names())
    renderer.close()
    return dataset


@pytest.fixture(scope="session")
def episodes(recorded: DemonstrationDataset) -> list[Frames]:
    """The same to export, with the truth about the can."""
    seen = ObservationFolder(recorded.path / "observations")
    return list(read_frames(recorded, fps=CAN.scene.fps, observations=seen, privileged=True, failures=True))
