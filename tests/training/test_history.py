from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynaforge.training.history import Probe, TrainingHistory


def history() -> TrainingHistory:
    return TrainingHistory(
        successes=[[1, 0], [2, 0], [2, 1]],
        trials=[[2, 2], [2, 0], [2, 2]],
        groups=[[1, 1, 0], [1, 0, 1], [0, 1, 1]],
        timesteps=[10, 25, 40],
        optimizer_steps=[4, 4, 8],
        transitions_used=[5, 5, 12],
        collect_wall=[1.0, 1.5, 2.0],
        collect_cpu=[1.0, 1.0, 1.0],
        optimize_wall=[0.5, 0.0, 0.5],
        optimize_cpu=[0.5, 0.0, 0.5],
        probes=[Probe(0, 0, [False, False]), Probe(2, 25, [True, False])],
    )


def test_success_is_the_mean_over_the_strata_and_one_that_was_left_out_keeps_its_last() -> None:
    np.testing.assert_allclose(history().success, [0.25, 0.5, 0.75])
    assert len(history()) == 3


def test_the_part_up_to_a_checkpoint_ends_at_its_steps() -> None:
    part = history().up_to(25)
    assert part.timesteps == [10, 25]
    assert part.groups == [[1, 1, 0], [1, 0, 1]]
    assert [probe.update for probe in part.probes] == [0, 2]
    assert [probe.update for probe in history().up_to(24).probes] == [0]
    assert len(history().up_to(9)) == 0


def test_a_history_survives_a_file(tmp_path: Path) -> None:
    history().save(tmp_path / "history.json")
    assert TrainingHistory.load(tmp_path / "history.json") == history()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"probes": 3}',
        '{"successes": []}',
        '{"probes": [], "unknown": 1}',
        '{"probes": [], "groups": 3}',
        '{"probes": [], "timesteps": ["x"]}',
        '{"probes": [], "trials": [[1, null]]}',
        "[" * 10**5,
        '{"probes": [{"update": 1, "timesteps": NaN, "success": []}]}',
        '{"probes": [{"update": 1, "timesteps": 1, "success": 3}]}',
    ],
)
def test_a_file_that_is_not_a_history_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "history.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"history\.json is not a training history"):
        TrainingHistory.load(path)
