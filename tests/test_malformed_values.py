"""Whatever is passed to a public constructor is taken, or refused by a message that names the argument."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaforge.demos import Attempt, DemonstrationDataset, Episode
from dynaforge.demos.ledger import Ledger
from dynaforge.demos.provenance import Provenance
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.task_env import TaskEnv
from dynaforge.envs.world import World
from dynaforge.generators import ConditionSource, ExploringPolicy, Goal, PlannerOnly, ResidualGenerator, collect
from dynaforge.generators.generator import ConstantResidual
from dynaforge.generators.oracle import Oracle
from dynaforge.geometry import Pose
from dynaforge.sim import (
    BodySpec,
    Condition,
    Drive,
    FixtureSpec,
    Launch,
    Placement,
    SceneSpec,
    SimScene,
    Spring,
    franka,
)
from dynaforge.sim.camera import Camera
from dynaforge.sim.robot import RobotDescription
from dynaforge.tasks import ConditionSpace, Outcome, Phase, ResidualSpec, Task, get_task
from dynaforge.tasks.action import ActionLayout

CAN, CLOCK = get_task("can"), get_task("alarmclock")
CONDITION = CAN.conditions.draw(np.random.default_rng(0))
STILL = np.zeros(3)
POLICY = ConstantResidual(np.zeros(5, np.float32))

MALFORMED: dict[str, Any] = {
    "None": None,
    "empty text": "",
    "text": "1",
    "line break": "x\ny",
    "path": "../x",
    "bytes": b"x",
    "zero": 0,
    "-1": -1,
    "fraction": 2.5,
    "nan": float("nan"),
    "inf": float("inf"),
    "-inf": float("-inf"),
    "huge": 1e308,
    "long": 10**400,
    "very long": 10**5000,
    "True": True,
    "complex": 1j,
    "list": [],
    "dict": {},
    "tuple": (),
    "pair": (1, 2),
    "object": object(),
    "odd dict": {3: None},
    "odd list": [None],
    "class": dict,
    "function": len,
    "nan array": np.array([float("nan")] * 3),
    "matrix": np.zeros((2, 2)),
    "path object": Path("x"),
}


def of(thing: Any) -> dict[str, Any]:
    return {field.name: getattr(thing, field.name) for field in fields(thing)}


def _episode() -> Episode:
    return Episode(
        condition=CONDITION,
        generator="planner",
        outcome=Outcome(success=True, checkpoint=4, n_checkpoints=4, phase="lift"),
        duration=1.0,
        steps={"time": np.arange(3) / 30},
        meta={"versions": {}},
    )


CONSTRUCTORS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "Condition": (Condition, of(CONDITION)),
    "Launch": (Launch, of(Launch(Pose.identity(), STILL, STILL, 0.1))),
    "Drive": (Drive, of(Drive())),
    "Placement": (Placement, of(Placement(Pose.identity()))),
    "Spring": (Spring, of(Spring("press", 1.0))),
    "BodySpec": (BodySpec, of(CAN.scene.bodies[0])),
    "FixtureSpec": (FixtureSpec, of(CLOCK.scene.fixtures[0])),
    "SceneSpec": (SceneSpec, of(CAN.scene)),
    "RobotDescription": (RobotDescription, of(franka())),
    "Camera": (Camera, of(Camera("front", (1.0, 0.0, 1.0), (0.0, 0.0, 0.0)))),
    "ConditionSpace": (ConditionSpace, of(CAN.conditions)),
    "Phase": (Phase, of(CAN.phases[1])),
    "ResidualSpec": (ResidualSpec, of(CAN.residual)),
    "Task": (Task, of(CAN)),
    "ActionLayout": (ActionLayout, of(ActionLayout())),
    "Outcome": (Outcome, of(_episode().outcome)),
    "Outcome.from_dict": (Outcome.from_dict, {"data": _episode().outcome.to_dict()}),
    "Episode": (Episode, of(_episode())),
    "Attempt": (Attempt, of(Attempt.of(_episode()))),
    "Provenance": (Provenance, of(Provenance("", ""))),
    "Ledger": (Ledger, {"path": "ledger.jsonl", "fsync": True}),
    "DemonstrationDataset": (DemonstrationDataset, {"path": "data", "task": "can", "keep_failures": False}),
    "Goal": (Goal, of(Goal(1, 1))),
    "ConditionSource": (ConditionSource, of(ConditionSource())),
    "ResidualGenerator": (ResidualGenerator, {"policy": POLICY, "policy_hash": "", "name": "residual"}),
    "ConstantResidual": (ConstantResidual, {"action": np.zeros(5)}),
    "ExploringPolicy": (ExploringPolicy, {"policy": POLICY, "sigma": 0.3}),
    "Oracle": (Oracle, {"m": 4, "name": "oracle"}),
    "draw": (CAN.conditions.draw, {"rng": np.random.default_rng(0), "stratum": 0, "n_strata": 4}),
    "stratum": (CAN.conditions.stratum, {"difficulty": 0.5, "n_strata": 4}),
    "validate": (CAN.conditions.validate, {"condition": CONDITION}),
    "stream": (CAN.conditions.stream, {"stream": "val", "block": 0, "n_strata": 4, "shard": (0, 1)}),
    "Condition.from_dict": (Condition.from_dict, {"data": CONDITION.to_dict()}),
    "Camera.from_dict": (Camera.from_dict, {"data": {"name": "x", "eye": [1, 0, 1], "look_at": [0, 0, 0]}}),
    "Attempt.from_dict": (Attempt.from_dict, {"data": Attempt.of(_episode()).to_dict()}),
}


def refusals(make: Callable[..., Any], good: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Try every malformed value as every argument; yield argument, value and message of those refused."""
    make(**good)
    for name in good:
        for kind, value in MALFORMED.items():
            try:
                make(**{**good, name: value})
            except (ValueError, TypeError, FileNotFoundError) as error:
                yield name, kind, str(error)


@pytest.mark.parametrize("name", CONSTRUCTORS)
def test_a_malformed_value_is_taken_or_refused_by_name(name: str, tmp_path: Path, monkeypatch: Any) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    make, good = CONSTRUCTORS[name]
    refused = 0
    for argument, kind, message in refusals(make, good):
        refused += 1
        assert argument.removesuffix("s") in message.lower() or argument == "data", (argument, kind, message)
        assert "\n" not in message, (argument, kind)
        assert len(message) < 1500, (argument, kind)
    assert refused > len(MALFORMED) // 3


MAKERS: list[tuple[str, Callable[[Any], Any]]] = [
    ("task", ResidualEnv),
    ("task", TaskEnv),
    ("task", World),
    ("task", get_task),
    ("spec", SimScene),
    ("robot", lambda given: SimScene(CAN.scene, robot=given)),
    ("gate_mode", lambda given: ResidualEnv(gate_mode=given)),
    ("render_mode", lambda given: TaskEnv(render_mode=given)),
    ("action_mode", lambda given: TaskEnv(action_mode=given)),
]


@pytest.mark.parametrize("kind", sorted(set(MALFORMED) - {"None"}))
def test_no_env_and_no_scene_is_made_of_it(kind: str) -> None:
    for name, make in MAKERS:
        with pytest.raises(ValueError, match=f"{name} "):
            make(MALFORMED[kind])


def test_collecting_with_something_else_is_refused_before_it_starts(tmp_path: Path) -> None:
    good = {
        "dataset": DemonstrationDataset(tmp_path, task="can"),
        "task": CAN,
        "generator": PlannerOnly(),
        "goal": Goal(1, 1),
    }
    for name, value in (("dataset", str(tmp_path)), ("task", "can"), ("goal", 5), ("source", (0, 1)), ("workers", 0)):
        with pytest.raises(ValueError, match=name):
            collect(**{**good, name: value})
