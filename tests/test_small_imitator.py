"""The small network of results/ learns from a dataset and is measured in the task's env."""

from __future__ import annotations

import sys
from itertools import islice
from pathlib import Path

import pytest
from safetensors.torch import save_file

from dynaforge.demos import DemonstrationDataset
from dynaforge.generators import Goal, LearnerGenerator, ResidualGenerator, collect, run_attempts
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import get_task

SCRIPT = Path(__file__).parents[1] / "results" / "small_imitator.py"
pytestmark = pytest.mark.skipif(not SCRIPT.exists(), reason="results are not part of a source distribution")


def successes(folder: Path, monkeypatch: pytest.MonkeyPatch, *, demos: int, updates: int, attempts: int) -> int:
    from dynaforge.algos.policy_file import MlpPolicyFile

    task = get_task("can")
    dataset = DemonstrationDataset(folder / "can", task="can")
    policy = MlpPolicyFile.load(asset_path("can/policy.safetensors"), task="can")
    collect(dataset, task, ResidualGenerator(policy), Goal(demos, None), workers=1)
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    import small_imitator

    trained = small_imitator.train(dataset.path, updates, 0)
    small_imitator.WEIGHTS.mkdir(parents=True)
    save_file(trained.state_dict(), small_imitator.WEIGHTS / "can.safetensors")
    learner = LearnerGenerator(f"{SCRIPT}:load")
    results = list(run_attempts(task, learner, islice(task.conditions.stream("val"), attempts), workers=1))
    sys.modules.pop("small_imitator")
    assert not [r.attempt.failure for r in results if "exception" in r.attempt.failure]
    return sum(result.attempt.success for result in results)


def test_the_small_imitator_trains_and_acts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    successes(tmp_path, monkeypatch, demos=1, updates=3, attempts=1)


@pytest.mark.slow
def test_a_small_network_cloned_from_200_demonstrations_succeeds_in_half(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert successes(tmp_path, monkeypatch, demos=200, updates=6000, attempts=60) >= 30
