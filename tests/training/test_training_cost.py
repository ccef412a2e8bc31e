"""What a training cost is read from what `compare` and `forge` left."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from dynaforge.tasks import get_task
from dynaforge.tasks.digest import definition_of
from dynaforge.training.history import TrainingHistory
from dynaforge.training.run_archive import write_archives
from dynaforge.training.training_cost import training_cost

CAN = get_task("can")
WRITTEN_BEFORE = Path(__file__).parents[1] / "written_before"


def history(hours: float) -> dict[str, Any]:
    """A history of two updates that took so many CPU-hours, and much longer on the clock."""
    half = 3600.0 * hours / 2
    rows = {"collect_cpu": [half - 1.0] * 2, "optimize_cpu": [1.0] * 2, "collect_wall": [9.0 * half] * 2}
    return {"timesteps": [5, 9], "probes": [], **rows}


def run(root: Path, variant: str, seed: int, hours: float, **made_for: Any) -> Path:
    folder = root / "can" / variant / f"seed-{seed}"
    folder.mkdir(parents=True)
    made = {"arm": variant, "seed": seed, **definition_of(CAN), **made_for}
    attempts = [{"block": 0, "id": "c0", "difficulty": 0.1, "outcome": "success"}]
    files = {
        "run.json": {"run": made, "settings": {}},
        "history.json": history(hours),
        "exam.json": {"task": "can", "attempts": attempts},
    }
    for name, content in files.items():
        (folder / name).write_text(json.dumps(content))
    return folder


def test_seeds_are_averaged_whether_their_folders_or_the_archive_is_left(tmp_path: Path) -> None:
    folders = [run(tmp_path, "failures", seed, hours) for seed, hours in enumerate((0.5, 1.0, 1.5))]
    write_archives(folders[:2])
    shutil.rmtree(folders[0])
    cost = training_cost(tmp_path, CAN)
    assert (cost.variant, cost.hours, cost.mean) == ("failures", pytest.approx((0.5, 1.0, 1.5)), pytest.approx(1.0))


def test_a_run_of_forge_counts_once_it_is_trained(tmp_path: Path) -> None:
    request = {"task": "can", "algo": "frontier_grpo", **definition_of(CAN)}
    (tmp_path / "forge.json").write_text(json.dumps(request))
    TrainingHistory.of(history(0.25)).save(tmp_path / "history.json")
    with pytest.raises(ValueError, match="no finished training of 'can'"):
        training_cost(tmp_path, CAN)
    (tmp_path / "trained.json").write_text("{}")
    assert training_cost(tmp_path, CAN).hours == pytest.approx((0.25,))
    with pytest.raises(ValueError, match="no finished training of 'peach'"):
        training_cost(tmp_path, get_task("peach"))


def test_a_training_in_another_setting_counts_and_one_of_another_definition_does_not(tmp_path: Path) -> None:
    strict = CAN.under(reflex="strict")
    run(tmp_path, "failures", 0, 1.0, **definition_of(strict))
    assert training_cost(tmp_path, CAN).mean == pytest.approx(1.0)
    run(tmp_path, "failures", 1, 1.0, task_definition="0123456789abcdef")
    with pytest.raises(ValueError, match="another definition of 'can'"):
        training_cost(tmp_path, CAN)


def test_trainings_of_the_older_physics_do_not_count() -> None:
    for folder in ("compare", "forge"):
        with pytest.raises(ValueError, match="another definition of 'can'"):
            training_cost(WRITTEN_BEFORE / folder, CAN)


def test_a_variant_is_chosen_where_there_are_several(tmp_path: Path) -> None:
    for variant, hours in (("failures", 1.0), ("grpo", 2.0)):
        run(tmp_path, variant, 0, hours)
    with pytest.raises(ValueError, match="by failures, grpo; choose one"):
        training_cost(tmp_path, CAN)
    assert training_cost(tmp_path, CAN, variant="grpo").mean == pytest.approx(2.0)
    with pytest.raises(ValueError, match="by 'ppo', but by failures, grpo"):
        training_cost(tmp_path, CAN, variant="ppo")


def test_a_damaged_training_is_named(tmp_path: Path) -> None:
    (run(tmp_path, "failures", 0, 1.0) / "history.json").write_text('{"timesteps": ["x"], "probes": []}')
    with pytest.raises(ValueError, match="no readable training of 'can': ValueError: timesteps"):
        training_cost(tmp_path, CAN)
