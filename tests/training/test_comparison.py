from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynaforge.training.comparison import Comparison
from dynaforge.training.comparison_table import comparison_table
from dynaforge.training.history import Probe, TrainingHistory
from dynaforge.training.run_spec import Evaluation
from dynaforge.training.stored_run import StoredRun

STRATA = 4


def history(success: list[float], *, optimizer_steps: int, probes: list[list[int]] | None = None) -> TrainingHistory:
    """Training with this success at each update of 100 steps, 10 rollouts per stratum, all strata alike."""
    n = len(success)
    return TrainingHistory(
        successes=[[round(10 * s)] * STRATA for s in success],
        trials=[[10] * STRATA] * n,
        groups=[[1, 2, 1]] * n,
        timesteps=[100 * (k + 1) for k in range(n)],
        optimizer_steps=[optimizer_steps * (k + 1) // n for k in range(n)],
        transitions_used=[10 * (k + 1) for k in range(n)],
        collect_wall=[1.0] * n,
        collect_cpu=[60.0] * n,
        optimize_wall=[1.0] * n,
        optimize_cpu=[6.0] * n,
        probes=[Probe(k, 100 * k, [bool(x) for x in row]) for k, row in enumerate(probes or [])],
    )


def run(task: str, variant: str, seed: int, successes: int, trained: TrainingHistory | None) -> StoredRun:
    return StoredRun(
        task=task,
        variant=variant,
        seed=seed,
        settings={},
        history=trained,
        success=np.arange(10) < successes,
        conditions=tuple(f"{task}-{k}" for k in range(10)),
        failures=("dropped",) * (10 - successes),
        evaluation=Evaluation("val", 1, 10),
    )


SLOW = history([0.0, 0.2, 0.4, 0.4], optimizer_steps=40)
FAST = history([0.4, 0.6, 0.8, 0.8], optimizer_steps=10)
RUNS = Comparison(
    (
        run("can", "planner_only", 0, 1, None),
        run("can", "grpo", 0, 4, SLOW),
        run("can", "grpo", 1, 6, SLOW),
        run("can", "frontier_grpo", 0, 9, FAST),
        run("can", "frontier_grpo", 1, 9, FAST),
    )
)


def test_variants_are_compared_with_vanilla() -> None:
    assert RUNS.reference == "grpo"
    assert RUNS.variants == ["grpo", "frontier_grpo"]
    found = RUNS.difference("frontier_grpo", ["can"])
    assert found.difference == pytest.approx(0.4)
    assert found.interval.low < 0.4 < found.interval.high
    assert RUNS.planner("can") == pytest.approx(0.1)


def test_the_figures_of_a_variant() -> None:
    summary = RUNS.summary("can", "frontier_grpo")
    assert summary.rates == (0.9, 0.9)
    assert summary.optimizer_steps == 10
    assert summary.collect_cpu == 240.0
    assert summary.transitions_used == 40
    assert (summary.collect_wall, summary.optimize_wall) == (4.0, 4.0)
    assert summary.groups == (0.25, 0.5, 0.25)
    # Vanilla ends at a trailing mean of (0 + .2 + .4 + .4) / 4 = .25, which the fast run has after its first update.
    assert summary.steps_to_vanilla == 100.0
    assert RUNS.summary("can", "grpo").steps_to_vanilla == 400.0


def test_steps_to_vanilla_without_exploration_are_those_of_three_probes() -> None:
    """Vanilla's last five probes succeed on 1 of 2 strata on average; the first three of the other variant do."""
    vanilla = history([0.5] * 6, optimizer_steps=1, probes=[[0, 0], [1, 0], [1, 0], [1, 0], [1, 0], [1, 0]])
    faster = history([0.5] * 6, optimizer_steps=1, probes=[[0, 0], [1, 0], [1, 1], [1, 0], [1, 1], [1, 1]])
    never = history([0.5] * 6, optimizer_steps=1, probes=[[0, 0]] * 6)
    runs = [run("can", name, 0, 5, trained) for name, trained in (("grpo", vanilla), ("x", faster), ("y", never))]
    comparison = Comparison(tuple(runs))
    summaries = [comparison.summary("can", name) for name in ("grpo", "x", "y")]
    assert [summary.probe_steps_to_vanilla for summary in summaries] == [300.0, 200.0, float("inf")]
    assert [summary.final_probes for summary in summaries] == [0.5, 0.8, 0.0]


def test_the_table_contains_every_variant_and_the_ratios() -> None:
    table = comparison_table(RUNS)
    row = next(line for line in table.splitlines() if "frontier_grpo" in line)
    for cell in ("90.0", "10", "+40.0", "0.25 x", "4.0", "0.40"):
        assert cell in row, cell
    assert "planner only" in table


def test_seeds_that_end_apart_are_compared_by_their_mean_curve() -> None:
    slower = history([0.0, 0.0, 0.0, 0.0], optimizer_steps=40)
    comparison = Comparison(
        (
            run("can", "grpo", 0, 4, SLOW),
            run("can", "grpo", 1, 0, slower),
            run("can", "frontier_grpo", 0, 9, FAST),
            run("can", "frontier_grpo", 1, 0, slower),
        )
    )
    # Vanilla's seeds end at trailing means of .25 and 0: .125 together, which the other reaches after one update.
    assert comparison.summary("can", "grpo").steps_to_vanilla == 400.0
    assert comparison.summary("can", "frontier_grpo").steps_to_vanilla == 100.0


def test_what_is_not_reached_is_a_dash() -> None:
    never = history([0.0, 0.0, 0.1, 0.1], optimizer_steps=10)
    comparison = Comparison((run("can", "grpo", 0, 5, SLOW), run("can", "ppo", 0, 1, never)))
    row = next(line for line in comparison_table(comparison).splitlines() if "ppo" in line)
    assert " - " in row
    assert "inf" not in row


def test_strata_that_are_forgotten_are_counted() -> None:
    probes = [[1, 1, 0, 1], [1, 1, 0, 1], [1, 0, 1, 1], [1, 0, 1, 0], [1, 0, 0, 1]]
    forgetful = history([0.5] * 5, optimizer_steps=1, probes=probes)
    comparison = Comparison((run("can", "grpo", 0, 5, forgetful),))
    # Stratum 1 succeeded in two probes in a row and failed in the last two; stratum 3 succeeded again.
    assert comparison.summary("can", "grpo").forgotten == pytest.approx(0.25)


def test_runs_measured_on_different_conditions_do_not_compare(tmp_path: Path) -> None:
    for k in range(2):
        (tmp_path / str(k)).mkdir()
        attempts = [{"block": 0, "id": f"c{k}", "difficulty": 0.5, "outcome": "success"}]
        exam = {"stream": "val", "blocks": 1, "attempts": 1}
        (tmp_path / str(k) / "exam.json").write_text(json.dumps({"task": "can", "exam": exam, "attempts": attempts}))
    with pytest.raises(ValueError, match="measured on different conditions"):
        Comparison.load(tmp_path, [tmp_path / "0", tmp_path / "1"])
    (tmp_path / "0" / "exam.json").write_text("{")
    with pytest.raises(ValueError, match="holds no readable run"):
        Comparison.load(tmp_path, [tmp_path / "0"])


def test_runs_of_several_definitions_are_named_and_not_to_be_compared() -> None:
    assert "Made under older physics.\n" in comparison_table(RUNS)
    ours = [replace(r, definition="1", setting="reflex contact") for r in RUNS.runs]
    assert "Made under reflex contact.\n" in comparison_table(Comparison(tuple(ours)))
    peg = [replace(r, task="peg") for r in RUNS.runs]
    apart = Comparison((*ours, *peg))
    assert "Made under reflex contact (can); older physics (peg).\n" in comparison_table(apart)
    assert "Do not compare" not in comparison_table(apart)
    mixed = Comparison((*ours[:3], *RUNS.runs[3:], *peg))
    assert mixed.mixed_tasks == ["can"]
    table = comparison_table(mixed)
    assert "reflex contact (can/planner_only, can/grpo); older physics (can/frontier_grpo, peg)" in table
    assert "Do not compare the runs of can: they are of several definitions of the task." in table
