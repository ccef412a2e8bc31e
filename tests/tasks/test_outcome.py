"""An outcome is one value: what is written of it anywhere reads back as itself."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

from dynaforge.tasks import Outcome

WON = Outcome(success=True, checkpoint=5, n_checkpoints=5, phase="lift")
LOST = Outcome(success=False, checkpoint=2, n_checkpoints=5, failure="dropped", phase="close")


@pytest.mark.parametrize(("checkpoint", "value"), [(0, 0.0), (1, 0.2), (4, 0.8)])
def test_a_failure_is_worth_its_share_of_checkpoints(checkpoint: int, value: float) -> None:
    """Eq. 6 with y = 0: c / C."""
    outcome = Outcome(success=False, checkpoint=checkpoint, n_checkpoints=5, failure="slipped")
    assert outcome.episodic_return() == pytest.approx(value)


def test_a_success_is_worth_one() -> None:
    assert WON.episodic_return() == 1.0
    assert Outcome.from_dict(WON.to_dict()).episodic_return() == 1.0


def test_the_return_of_a_failure_needs_all_checkpoints() -> None:
    with pytest.raises(ValueError, match="needs n_checkpoints"):
        Outcome.from_dict(LOST.to_dict()).episodic_return()


@pytest.mark.parametrize("outcome", [WON, LOST])
def test_it_reads_back_as_itself(outcome: Outcome) -> None:
    beside = {"duration": 1.0, "difficulty": 0.5}
    assert Outcome.from_dict(json.loads(json.dumps(outcome.to_dict() | beside))) == outcome
    assert Outcome.of_info(outcome.as_info() | beside) == outcome
    assert pickle.loads(pickle.dumps(outcome)).episodic_return() == outcome.episodic_return()


def test_an_info_in_the_middle_of_an_episode_contains_none() -> None:
    assert Outcome.of_info({"is_success": False, "residual_mask": 1.0}) is None


def test_without_a_phase_program_an_info_names_neither_phase_nor_checkpoint() -> None:
    assert Outcome(success=False, checkpoint=0, failure="timeout").as_info() == {
        "is_success": False,
        "failure": "timeout",
    }


def test_numbers_of_numpy_go_into_json() -> None:
    outcome = Outcome(success=np.True_, checkpoint=np.int64(5))  # type: ignore[arg-type]
    assert json.dumps(outcome.to_dict()) == json.dumps(WON.to_dict() | {"phase": ""})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"success": False, "checkpoint": 0}, "needs a reason"),
        ({"success": True, "checkpoint": 4, "failure": "timeout"}, "no failure reason"),
        ({"success": True, "checkpoint": 4, "n_checkpoints": 5}, "reached the last"),
        ({"success": False, "checkpoint": 5, "n_checkpoints": 5, "failure": "x"}, "reached the last"),
        ({"success": False, "checkpoint": 6, "n_checkpoints": 5, "failure": "x"}, "reached the last"),
    ],
)
def test_what_contradicts_itself_is_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Outcome(**fields)  # type: ignore[arg-type]
