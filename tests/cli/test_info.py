from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.generators import Goal, PlannerOnly, collect
from dynaforge.tasks import get_task


def test_info_tells_of_rates_lengths_residuals_and_size(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can", keep_failures=True)
    done = collect(dataset, get_task("can"), PlannerOnly(), Goal(None, 3), workers=1)
    assert main(["info", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "Can, 3 recordings of 3 attempts" in printed
    for reason in {attempt.failure for attempt in done if not attempt.success}:
        assert reason in printed
    assert "planner_only: success with the reflex contact" in printed
    steps = sum(len(episode) for episode in dataset)
    assert f"{steps} steps in all" in printed
    width = np.concatenate([e.steps["projected_action"][:, 7] for e in dataset])
    assert f"  width       {width.min():+.3f} to {width.max():+.3f}" in printed
    speeds = [line for line in printed.splitlines() if line.startswith("  speed ")]
    assert speeds[0].endswith(f"{len({int((e.condition.difficulty - 0.05) / 1.45 * 16) for e in dataset})} of 16 parts")
    assert "width       +0.000 +0.000 +0.000" in printed, "the planner has no residual"


def test_info_of_an_empty_folder_and_of_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    DemonstrationDataset(tmp_path / "data", task="peach")
    assert main(["info", str(tmp_path / "data")]) == 0
    assert "Peach, 0 recordings of 0 attempts" in capsys.readouterr().out
    assert main(["info", str(tmp_path / "nowhere")]) == 2
