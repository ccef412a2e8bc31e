"""The picture of why: which condition is shown, what is written under a frame, and what the command writes."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaforge.cli import report
from dynaforge.cli.main import main
from dynaforge.demos import Episode
from dynaforge.reports.motivation import FRAME_STEPS, Shot, first_telling, greatest_since, moments, shoot
from dynaforge.sim import Condition, SimScene
from dynaforge.tasks import Outcome, Task, get_task

CAN = get_task("can")
CONDITIONS = list(islice(CAN.conditions.stream("val"), 5))
PNG, MP4 = b"\x89PNG", b"ftyp"


def episode(condition: Condition, *, success: bool, contact: float | None = None, steps: int = 9) -> Episode:
    outcome = (
        Outcome(success=True, checkpoint=5) if success else Outcome(success=False, checkpoint=1, failure="slipped")
    )
    return Episode(
        condition=condition,
        generator="planner_only",
        outcome=outcome,
        duration=1.0,
        steps={"time": np.arange(float(steps)), "peak_force": np.arange(float(steps))},
        meta={"contact_time": contact},
    )


class Scripted:
    """Succeeds on the conditions with these places, and counts its attempts and its closed envs."""

    name = "scripted"

    def __init__(self, *succeeds: int) -> None:
        self.succeeds, self.attempts, self.closed = succeeds, 0, 0

    def make_env(self, task: Task) -> Scripted:
        return self

    def close(self) -> None:
        self.closed += 1

    def attempt(self, env: Any, condition: Condition) -> Episode:
        self.attempts += 1
        return episode(condition, success=CONDITIONS.index(condition) in self.succeeds)


def shot(*, n: int = 4, success: bool = True, contact: float | None = None, forces: float = 1.0) -> Shot:
    made = episode(CONDITIONS[0], success=success, contact=contact)
    frames = [np.full((6, 8, 3), k, np.uint8) for k in range(n)]
    return Shot(label="a", episode=made, frames=frames, forces=forces * np.arange(float(n)), interval=0.5)


def test_the_first_condition_that_one_fails_and_the_other_solves_is_shown() -> None:
    planner, solver = Scripted(0, 3), Scripted(0, 2, 3, 4)
    found = first_telling(CAN, planner, solver, CONDITIONS)
    assert found is not None
    index, failed, solved = found
    assert (index, failed.success, solved.success) == (2, False, True)
    assert failed.condition == solved.condition == CONDITIONS[2]
    assert (planner.attempts, solver.attempts) == (3, 2), "what the planner solves, nobody else attempts"
    assert planner.closed == solver.closed == 1
    assert first_telling(CAN, Scripted(*range(5)), solver, CONDITIONS) is None


def test_no_force_between_two_frames_is_lost() -> None:
    forces = np.array([1.0, 9.0, 2.0, 3.0, 4.0, 8.0])
    np.testing.assert_array_equal(greatest_since(forces, 2), [1.0, 9.0, 4.0])
    np.testing.assert_array_equal(greatest_since(forces, 1), forces)


def test_the_strip_is_about_the_touches_of_all_shots() -> None:
    touching = [shot(n=20, contact=2.0), shot(n=20, contact=4.0), shot(n=20)]
    np.testing.assert_allclose(moments(touching, 3), [1.5, 3.75, 6.0])
    np.testing.assert_allclose(moments([shot(n=5)], 3), [0.0, 1.0, 2.0])
    np.testing.assert_allclose(moments([shot(n=5, contact=0.1)], 2), [0.0, 2.0])


def test_a_caption_tells_the_force_and_at_the_end_the_outcome() -> None:
    failed = shot(success=False, forces=10.0)
    assert failed.caption(0.6) == "0.50 s   10 N"
    assert failed.caption(9.0) == "1.50 s   30 N   slipped"
    assert shot().caption(9.0).endswith("success")


def test_an_attempt_that_left_no_recording_is_not_filmed() -> None:
    empty = replace(episode(CONDITIONS[0], success=False), steps={})
    with pytest.raises(ValueError, match="attempt of 'planner_only' cannot be filmed: slipped"):
        shoot(CAN, [("a", empty)])


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimScene, "picture", lambda self, camera: np.full((12, 16, 3), 128, np.uint8))


def test_the_command_films_three_generators_on_one_condition(
    small: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "why"
    line = ["report", "motivation", "--task", "can", "--conditions", "8", "--frames", "3", "--out", str(out)]
    assert main(line) == 0
    printed = capsys.readouterr().out
    assert "the first that the planner fails" in printed
    assert (out / "motivation.png").read_bytes()[:4] == PNG
    assert (out / "motivation.mp4").read_bytes()[4:8] == MP4
    told = json.loads((out / "motivation.json").read_text())
    planner, replay, residual = told["attempts"]
    assert [each["generator"] for each in told["attempts"]] == ["planner_only", "replay-task-speed", "residual"]
    assert replay["duration"] > 1.0
    assert residual["outcome"] == "success" != planner["outcome"]
    assert residual["peak_force"] > 1.0


def test_a_task_that_cannot_be_replayed_is_shown_without_a_replay(capsys: pytest.CaptureFixture[str]) -> None:
    assert report._replay(get_task("lemon")) is None
    assert "replay is left out: The generator replay is for the tasks can, bottle" in capsys.readouterr().out


def test_a_task_without_a_policy_is_refused_before_the_work(
    ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "why"
    assert main(["report", "motivation", "--task", str(ball), "--out", str(out)]) == 2
    assert "No policy is shipped for task 'ball'" in capsys.readouterr().err
    assert not out.exists()


def test_a_film_has_a_frame_for_every_second_control_step(small: None) -> None:
    from dynaforge.generators import PlannerOnly
    from dynaforge.generators.generator import make_env

    env = make_env(PlannerOnly(), CAN)
    made = PlannerOnly().attempt(env, CONDITIONS[0])
    env.close()
    (filmed,) = shoot(CAN, [("planner only", made)])
    assert len(filmed.frames) == len(filmed.forces) == -(-len(made) // FRAME_STEPS)
    assert filmed.forces.max() == made.steps["peak_force"][: FRAME_STEPS * (len(filmed.frames) - 1) + 1].max()
    assert filmed.end == pytest.approx((len(filmed.frames) - 1) * FRAME_STEPS * CAN.scene.control_dt)
