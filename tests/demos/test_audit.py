"""Recordings of real episodes break no law; every edit that breaks one is flagged at its step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset, Episode, audit
from dynaforge.demos.audit import Flag
from dynaforge.demos.provenance import Provenance
from dynaforge.demos.replay import Replayer
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import PlannerOnly
from dynaforge.registration import ENV_NAMES
from dynaforge.tasks import get_task

Columns = dict[str, np.ndarray]


def recorded(name: str, n: int = 1) -> list[Episode]:
    env = ResidualEnv(name)
    episodes = [PlannerOnly().attempt(env, c) for c in islice(env.task.conditions.stream("val", n_strata=8), n)]
    env.close()
    return episodes


@pytest.fixture(scope="module")
def can() -> Episode:
    """A can at 0.8 m/s, out of the hand's reach at step 5."""
    return recorded("can", 5)[4]


@pytest.mark.parametrize("name", ENV_NAMES)
def test_what_physics_made_is_possible(name: str) -> None:
    replayer = Replayer(get_task(name))
    for episode in recorded(name, 2):
        assert audit.audit(episode, replayer=replayer) == []
    replayer.close()


def teleport(steps: Columns) -> None:
    steps["object/can/position"][5:] += (0.0, 0.0, 0.15)


def speed_up(steps: Columns) -> None:
    steps["object/can/velocity"][5:] *= 1.5


def beyond_a_joint_limit(steps: Columns) -> None:
    steps["q"][5:, 3] = 0.0


def too_fast(steps: Columns) -> None:
    steps["dq"][5, 0] = 4.0


def snap(steps: Columns) -> None:
    steps["width"][:5], steps["width"][5:] = 0.08, 0.04


def ask_for_too_much_speed(steps: Columns) -> None:
    steps["joint_velocity_reference"][5, 2] = 2.8


def ask_for_too_much_speed_near_an_end(steps: Columns) -> None:
    steps["joint_reference"][5, 3] = -2.9481  # a tenth above the lower end of joint 4, which may go down at 0.594 rad/s
    steps["joint_velocity_reference"][5] = -0.7 * np.eye(7)[3]


def ask_for_too_much_acceleration(steps: Columns) -> None:
    steps["joint_velocity_reference"][:5], steps["joint_velocity_reference"][5:] = 0.0, 0.5


@pytest.mark.parametrize(
    ("edit", "violation"),
    [
        (teleport, "can jumps 0.1"),
        (speed_up, "with nothing near it"),
        (beyond_a_joint_limit, "beyond its limit"),
        (too_fast, "a joint moves at 1.53 of its speed limit"),
        (snap, "the hand opens or closes at 1.2"),
        (ask_for_too_much_speed, "commanded to 1.07 of its speed limit"),
        (ask_for_too_much_speed_near_an_end, "commanded to 1.08 of its speed limit"),
        (ask_for_too_much_acceleration, "commanded to 1.50 of its acceleration limit"),
    ],
)
def test_an_edit_is_flagged_where_it_was_made(can: Episode, edit: Callable[[Columns], None], violation: str) -> None:
    steps = {name: column.copy() for name, column in can.steps.items()}
    edit(steps)
    found = [flag for flag in audit.audit(replace(can, steps=steps)) if violation in str(flag)]
    assert [flag.step for flag in found] in ([4], [5])


def test_a_speed_within_the_limit_of_the_middle_of_its_step_is_possible(can: Episode) -> None:
    steps = {name: column.copy() for name, column in can.steps.items()}
    ask_for_too_much_speed_near_an_end(steps)
    steps["joint_velocity_reference"][5] *= 0.9  # 0.63 rad/s: over 0.594 at the end, under 0.640 half a step before
    assert "speed limit there" not in " ".join(map(str, audit.audit(replace(can, steps=steps))))


def test_jerk_counts_too(can: Episode) -> None:
    steps = {name: column.copy() for name, column in can.steps.items()}
    steps["joint_velocity_reference"][:] = 0.0
    steps["joint_velocity_reference"][5] = 3.0  # up and down again: 2 x 90 rad/s^2 within 1/30 s
    assert "commanded to 1.08 of its jerk limit" in " ".join(map(str, audit.audit(replace(can, steps=steps))))


def test_a_lasting_overlap_is_flagged(can: Episode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audit, "DEEP_CONTACT", -1.0)  # so that all that touches, and all that does not, is too deep
    replayer = Replayer(get_task("can"))
    flags = audit.audit(can, replayer=replayer)
    replayer.close()
    assert "robot and can overlap by up to" in " ".join(map(str, flags))
    assert f"for {len(can) + 1} steps" in flags[0].violation


def test_verify_tells_of_flags(can: Episode, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can", keep_failures=True)
    steps = {name: column.copy() for name, column in can.steps.items()}
    snap(steps)
    dataset.add(replace(can, steps=steps))
    dataset.note_source(can.generator, Provenance("", can.meta["task_hash"]))
    assert main(["verify", str(tmp_path)]) == 0
    assert main(["verify", str(tmp_path), "--audit"]) == 1
    assert f"{can.id}.h5: the hand opens or closes" in capsys.readouterr().out


def test_a_flag_counts_its_steps() -> None:
    assert str(Flag(3, "it jumps", 1)) == "it jumps at step 3"
    assert str(Flag(3, "it jumps", 4)) == "it jumps at step 3, and at 3 more"
