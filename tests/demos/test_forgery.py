"""A forger who recomputes every hash is found all the same: each column and each label is made again and compared."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaforge.demos import DemonstrationDataset, Episode
from dynaforge.demos.consistency import contradictions
from dynaforge.demos.differences import differences
from dynaforge.demos.episode_checks import of_physics
from dynaforge.demos.episode_file import write_episode
from dynaforge.demos.folder_checks import read_notes
from dynaforge.demos.observations import (
    ObservationFolder,
    ObservationRenderer,
    ObservationSettings,
    standard_cameras,
)
from dynaforge.demos.provenance import Provenance
from dynaforge.demos.replay import Replayer
from dynaforge.demos.schema import SCHEMA, state_digests
from dynaforge.demos.verification import EpisodeVerifier, verify
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import ExploringPolicy, ResidualGenerator
from dynaforge.generators.generator import ConstantResidual
from dynaforge.generators.learner import LearnerGenerator
from dynaforge.generators.repeat import Repeater
from dynaforge.planning import ArmKinematics
from dynaforge.registration import ENV_NAMES
from dynaforge.sim import franka
from dynaforge.tasks import Task, get_task
from dynaforge.tasks.digest import task_digest

TASK = "toycar"
COLUMNS = [
    name.replace("<name>", "toycar") for name in SCHEMA if not name.startswith(("fixture/", "sensed/"))
]  # those of a task without fixtures under ideal sensing
UNSEEN = {"dq", "width", "peak_force", "left_contact", "right_contact"} | {name for name in COLUMNS if "/" in name}


def recorded(task: Task, n: int) -> list[Episode]:
    env = ResidualEnv(task)
    noisy = ResidualGenerator(ExploringPolicy(ConstantResidual(np.zeros(env.action_space.shape, np.float32)), 0.3))
    episodes = [noisy.attempt(env, c) for c in islice(env.task.conditions.stream("val", n_strata=n), n)]
    env.close()
    return episodes


@pytest.fixture(scope="module")
def honest() -> Episode:
    return recorded(get_task(TASK), 1)[0]


@pytest.fixture(scope="module")
def again() -> Callable[[Episode], Episode]:
    """Make an attempt again, once for each residual: nothing else of the columns has a say in it."""
    repeat, made = Repeater(get_task(TASK)), dict[bytes, Episode]()

    def once(episode: Episode) -> Episode:
        key = episode.steps["residual_action"].tobytes() + episode.condition.id.encode()
        if key not in made:
            made[key] = repeat(episode)
        return made[key]

    return once


def problems(folder: Path, episode: Episode, again: Callable[[Episode], Episode] | None) -> list[str]:
    """Put a recording into a folder as a forger would, every hash and the ledger made anew, and verify it."""
    steps = episode.steps
    contacts = {
        "state_digests": state_digests(steps),
        "contact_time": _first(steps, steps["left_contact"] | steps["right_contact"]),
        "planned_contact_time": _first(steps, steps["phase"] >= get_task(TASK).contact_phase),
    }
    forged = replace(episode, meta=dict(episode.meta) | contacts)
    dataset = DemonstrationDataset(folder, task=TASK, keep_failures=True)
    dataset.add(forged)
    dataset.note_source(episode.generator, Provenance("", episode.meta["task_hash"]))
    found = [finding for findings in verify(dataset, task=get_task(TASK), again=again) for finding in findings]
    assert all(finding.path == dataset.file_of(episode.id) for finding in found)
    return [finding.problem for finding in found]


def _first(steps: Any, holds: np.ndarray) -> float | None:
    rows = np.flatnonzero(holds)
    return float(steps["time"][rows[0]]) if len(rows) else None


def forge(episode: Episode, name: str, *, least: bool) -> Episode:
    """Change a column at one step by as little as there is, or from the middle on by what a learner would notice."""
    column = episode.steps[name].copy()
    gated = np.flatnonzero(episode.steps["gate"])
    k = gated[len(gated) // 2]
    rows = slice(k, k + 1 if least else None)
    if column.dtype == bool:
        column[rows] = ~column[rows]
    elif column.dtype.kind == "i":
        column[rows] += 1
    elif name == "reward":
        column[-1] = 0.25
    else:
        much = 0.5 if name == "joint_velocity_reference" else 2e-3
        column[rows] = np.nextafter(column[rows], np.inf) if least else column[rows] + much
    return replace(episode, steps=dict(episode.steps) | {name: column})


def test_an_honest_recording_has_no_problem(tmp_path: Path, honest: Episode, again: Any) -> None:
    assert set(honest.steps) == set(COLUMNS), "every column of the schema is forged below"
    assert honest.steps["residual_action"].any()
    assert problems(tmp_path, honest, again) == []


@pytest.mark.parametrize("least", [True, False], ids=["least", "much"])
@pytest.mark.parametrize("name", COLUMNS)
def test_a_forged_column_is_named(tmp_path: Path, honest: Episode, again: Any, name: str, least: bool) -> None:
    found = problems(tmp_path, forge(honest, name, least=least), again)
    assert any(problem.startswith(name) or f"{name} " in problem for problem in found), found


@pytest.mark.parametrize("name", [name for name in COLUMNS if name not in UNSEEN])
def test_a_column_that_follows_from_others_is_named_without_a_replay(
    tmp_path: Path, honest: Episode, name: str
) -> None:
    found = problems(tmp_path, forge(honest, name, least=False), None)
    assert any(name in problem for problem in found), found


def failed(episode: Episode, **outcome: Any) -> Episode:
    """Tell another outcome, with the reward that goes with it."""
    claimed = replace(episode.outcome, n_checkpoints=None, **outcome)
    rewards = episode.steps["reward"].copy()
    rewards[-1] = 1.0 if claimed.success else claimed.checkpoint / get_task(TASK).n_checkpoints
    return replace(episode, outcome=claimed, steps=dict(episode.steps) | {"reward": rewards})


def other_condition(episode: Episode) -> Episode:
    values = dict(episode.condition.values)
    return replace(episode, condition=replace(episode.condition, values=values | {"lead": values["lead"] - 1e-3}))


def cut(episode: Episode) -> Episode:
    steps = {name: column[:-3] for name, column in episode.steps.items()}
    return replace(episode, steps=steps, duration=episode.duration - 3 * get_task(TASK).scene.control_dt)


def without(episode: Episode) -> Episode:
    return replace(episode, steps={name: c for name, c in episode.steps.items() if name != "planner_action"})


LABELS: dict[str, tuple[Callable[[Episode], Episode], str]] = {
    "success": (
        lambda e: failed(
            e,
            success=not e.success,
            failure="dropped" if e.success else "",
            checkpoint=5 - e.outcome.checkpoint,
        ),
        "its success is recorded as",
    ),
    "failure": (
        lambda e: failed(e, success=False, failure="the cat", checkpoint=1),
        "its failure is recorded as 'the cat'",
    ),
    "checkpoint": (lambda e: failed(e, checkpoint=3), "its checkpoint is recorded as 3"),
    "phase": (
        lambda e: replace(e, outcome=replace(e.outcome, phase="approach")),
        "its phase is recorded as 'approach'",
    ),
    "duration": (lambda e: replace(e, duration=e.duration + 1.0), "its duration is recorded as"),
    "loads": (lambda e: replace(e, loads=replace(e.loads, force=1.0)), "its greatest load is recorded as"),
    "no loads": (lambda e: replace(e, loads=None), "its greatest load is recorded as None"),
    "condition": (other_condition, "joint_reference is not what its attempt made again gives from step 0 on"),
    "length": (cut, "it continues after its last recorded step"),
    "a column left out": (without, "planner_action is missing"),
}


@pytest.mark.parametrize("label", LABELS)
def test_a_forged_label_is_named(tmp_path: Path, honest: Episode, again: Any, label: str) -> None:
    forged, what = LABELS[label]
    found = problems(tmp_path, forged(honest), again)
    assert any(what in problem for problem in found), found


def test_a_peak_above_that_of_its_episode_is_named_without_a_replay(tmp_path: Path, honest: Episode) -> None:
    assert honest.loads is not None
    peaks = honest.steps["peak_force"].copy()
    peaks[-1] = honest.loads.peak_force + 1.0
    (problem,) = problems(tmp_path, replace(honest, steps=dict(honest.steps) | {"peak_force": peaks}), None)
    assert problem.startswith("peak_force exceeds the episode's")


def test_forged_loads_are_named_where_only_the_joint_references_are_replayed(honest: Episode) -> None:
    assert honest.loads is not None
    with closing(Replayer(get_task(TASK))) as replayer:
        check = of_physics(None, replayer)
        assert list(check(honest)) == []
        (problem,) = check(replace(honest, loads=replace(honest.loads, strict=0.5)))
    assert problem.startswith("its loads are recorded as")


@pytest.mark.parametrize(
    "spec",
    [{"translation": (0.4, 0.4, 0.4)}, {"rotation": (0.5, 0.5, 0.5)}, {"width": 0.05}, {"decision_steps": 1}],
    ids=lambda spec: next(iter(spec)),
)
def test_a_residual_that_no_policy_could_ask_for_is_named(tmp_path: Path, spec: dict[str, Any]) -> None:
    """The whole episode is simulated with it, so all columns agree; only the task's own bounds tell."""
    task = get_task(TASK)
    forged = recorded(replace(task, residual=replace(task.residual, **spec)), 1)[0]
    repeat = Repeater(task)
    found = problems(tmp_path, replace(forged, meta=dict(forged.meta) | {"task_hash": task_digest(task)}), repeat)
    repeat.close()
    assert any(problem.startswith("residual_action") for problem in found), found


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n == "pen" else pytest.mark.slow) for n in ENV_NAMES])
def test_an_attempt_made_again_is_the_same_to_the_bit(name: str) -> None:
    task = get_task(name)
    repeat = Repeater(task)
    for episode in recorded(task, 1 if name == "pen" else 6):
        made = repeat(episode)
        assert differences(episode, made) == []
        assert made.content_hash() == episode.content_hash()
        assert list(contradictions(episode, task, ArmKinematics(franka()))) == []
    repeat.close()


class Wanders:
    """A policy that acts without the planner."""

    def __call__(self, observation: Any) -> np.ndarray:
        return np.array([0.5, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0, 0.04, 0.1]) + 0.05 * np.sin(observation["q"].sum())


def test_an_attempt_without_the_planner_is_checked_as_far_as_that_goes(tmp_path: Path) -> None:
    (tmp_path / "wanders.py").write_text("from test_forgery import Wanders\n\ndef make(name):\n    return Wanders()\n")
    generator, task = LearnerGenerator(f"{tmp_path / 'wanders.py'}:make"), get_task(TASK)
    env = generator.make_env(task)
    episode = generator.attempt(env, next(task.conditions.stream("val")))
    env.close()
    dataset = DemonstrationDataset(tmp_path / "data", task=TASK, keep_failures=True)
    dataset.note_source(episode.generator, Provenance("", task_digest(task)))
    dataset.add(episode)
    repeat, replayer = Repeater(task), Replayer(task)
    assert [f for found in verify(dataset, task=task, again=repeat, replayer=replayer) for f in found] == []
    write_episode(dataset.file_of(episode.id), forge_reference(episode))
    problems = [f.problem for found in verify(dataset, task=task, again=repeat, replayer=replayer) for f in found]
    assert any("its replay leaves the recording" in problem for problem in problems), problems
    assert any("projected_action is not where joint_reference" in problem for problem in problems), problems


def forge_reference(episode: Episode) -> Episode:
    column = episode.steps["joint_reference"].copy()
    column[10:] += 1e-3
    return replace(episode, steps=dict(episode.steps) | {"joint_reference": column})


def test_a_forged_picture_is_named(tmp_path: Path, honest: Episode) -> None:
    task, front = get_task(TASK), replace(standard_cameras(get_task(TASK))["front"], size=(12, 8))
    settings = ObservationSettings((front,), points=8)
    renderer = ObservationRenderer(task, settings)
    rendered = renderer.render(honest)
    renderer.close()
    dataset = DemonstrationDataset(tmp_path, task=TASK, keep_failures=True)
    dataset.note_source(honest.generator, Provenance("", task_digest(task)))
    dataset.add(honest)
    observations = ObservationFolder(tmp_path / "observations", settings)
    for name in (None, *rendered):
        arrays = {key: array.copy() for key, array in rendered.items()}
        if name is not None:
            arrays[name][5] = np.where(arrays[name][5] == 1, 2, 1)
        observations.write(honest, arrays, [])
        check = EpisodeVerifier(dataset, read_notes(dataset), task=task, render=lambda episode: rendered)
        expected = [f"{name} is not what rendering gives from step 5 on"] if name else []
        assert [finding.problem for finding in check(honest.id)] == expected
