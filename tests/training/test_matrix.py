from __future__ import annotations

from pathlib import Path

import pytest

from dynaforge.tasks import get_task
from dynaforge.training.matrix import Variants, compared_variants, refuse_links, run_matrix
from dynaforge.training.run_spec import PLANNER_ONLY, Evaluation, RunSpec

VARIANTS: Variants = {"grpo": ("grpo", {}), "slow": ("ppo", {"learning_rate": 1e-5})}


def test_the_planner_comes_first_and_then_seed_by_seed(tmp_path: Path) -> None:
    tasks = [get_task("can"), get_task("peg")]
    specs = run_matrix(tasks, VARIANTS, seeds=2, steps=100, evaluation=Evaluation(), out=tmp_path)
    assert [spec.variant for spec in specs[:2]] == [PLANNER_ONLY] * 2
    assert [(spec.seed, spec.task, spec.variant) for spec in specs[2:]] == [
        (seed, task, variant) for seed in (0, 1) for task in ("can", "peg") for variant in VARIANTS
    ]
    assert len({spec.folder for spec in specs}) == len(specs) == 10
    assert specs[-1].folder == tmp_path / "peg" / "slow" / "seed-1"
    assert specs[-1].changes == {"learning_rate": 1e-5}
    assert [RunSpec.from_json(spec.to_json()) for spec in specs] == specs


def test_each_value_of_a_setting_makes_a_variant() -> None:
    assert list(compared_variants(["ppo"])) == ["ppo"]
    varied = compared_variants(["ppo", "grpo"], ["learning_rate", "lin_1e-3", "2e-4"])
    assert list(varied) == [
        f"{name}+learning_rate={value}" for name in ("ppo", "grpo") for value in ("lin_1e-3", "2e-4")
    ]
    assert [changes["learning_rate"] for _, changes in varied.values()] == ["lin_1e-3", 2e-4] * 2


def test_runs_are_not_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "can").symlink_to("elsewhere")
    refuse_links(tmp_path / "peg" / "grpo", tmp_path)
    with pytest.raises(ValueError, match="can is a link"):
        refuse_links(tmp_path / "can" / "grpo", tmp_path)
