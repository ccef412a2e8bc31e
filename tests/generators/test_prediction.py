from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.generators import PlannerOnly, make_generator
from dynaforge.generators.generator import attempted_task, make_env
from dynaforge.generators.prediction import Prediction, chosen_lead_time
from dynaforge.tasks import TASK_NAMES, get_task
from dynaforge.tasks.digest import task_digest

CAN = get_task("can")


def test_with_no_lead_it_is_the_planner_and_with_one_it_is_that_of_the_task_with_that_lead() -> None:
    (condition,) = islice(CAN.conditions.stream("val"), 1)
    led = replace(CAN, lead_time=0.15)
    made = []
    for generator, task in (
        (PlannerOnly(), CAN),
        (Prediction(0.0), CAN),
        (PlannerOnly(), led),
        (Prediction(0.15), CAN),
    ):
        env = make_env(generator, task)
        made.append(generator.attempt(env, condition))
        env.close()
    planner, without, of_task, with_lead = ({**e.steps, "hash": e.meta["task_hash"]} for e in made)
    for a, b in ((planner, without), (of_task, with_lead)):
        assert all(np.array_equal(a[name], b[name]) for name in a)
    n = min(len(planner["q"]), len(with_lead["q"]))
    assert not np.array_equal(planner["q"][:n], with_lead["q"][:n])
    assert with_lead["hash"] == task_digest(led) != task_digest(CAN)


def test_its_lead_time_is_the_one_given_or_the_stored_choice() -> None:
    assert make_generator("prediction", CAN, lead_time=0.3) == Prediction(0.3)
    assert make_generator("prediction", CAN) == Prediction(chosen_lead_time(CAN))
    assert all(0.0 < chosen_lead_time(get_task(name)) < 1.0 for name in TASK_NAMES)
    assert attempted_task(PlannerOnly(), CAN) is CAN


@pytest.mark.parametrize("lead", [-0.1, float("nan"), "0.2", None])
def test_a_lead_time_that_is_none_is_refused(lead: object) -> None:
    with pytest.raises(ValueError, match="lead_time"):
        Prediction(lead)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--lead-time", "0.1"], "--lead-time 0.1 is for the generator prediction; --generator is planner_only"),
        (["--generator", "prediction", "--lead-time", "-1"], "--lead-time is -1; it must be at least 0"),
        (["--generator", "prediction", "--lead-time", "5"], "--lead-time is 5; it must be at most 2"),
    ],
)
def test_an_unusable_lead_time_is_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_what_it_collects_is_repeated_with_its_lead_time_and_never_mixed_with_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    collect = ["collect", "--attempts", "1", "--keep-failures", "--workers", "1", "--out", str(tmp_path / "data")]
    assert main([*collect, "--generator", "prediction", "--lead-time", "0.1"]) == 0
    assert DemonstrationDataset(tmp_path / "data").sources()["prediction"].lead_time == 0.1
    capsys.readouterr()
    assert main(["verify", str(tmp_path / "data"), "--replay", "--workers", "1"]) == 0
    assert "1 episodes read and made again, 1 attempts in the ledger: no problems" in capsys.readouterr().out
    assert main([*collect, "--generator", "planner_only"]) == 2
    assert "holds attempts of a planner that predicts by 0.1 s, not by 0 s" in capsys.readouterr().err
