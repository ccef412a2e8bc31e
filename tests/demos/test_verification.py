"""Whatever is done to a folder of demonstrations, verify names the file."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demo_episodes import make_episode

from dynaforge.cli.main import main
from dynaforge.demos import Attempt, DemonstrationDataset, Episode
from dynaforge.demos.episode_file import write_episode
from dynaforge.demos.observations import ObservationFolder, ObservationSettings, standard_cameras
from dynaforge.demos.provenance import Provenance
from dynaforge.demos.schema import state_digests
from dynaforge.demos.verification import verify
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import PlannerOnly
from dynaforge.sim.loads import Loads
from dynaforge.tasks import Outcome, get_task
from dynaforge.tasks.digest import task_digest

SETTINGS = ObservationSettings((replace(standard_cameras(get_task("can"))["front"], size=(4, 4)),))


@pytest.fixture
def dataset(tmp_path: Path) -> DemonstrationDataset:
    """Four successes, a failure that was kept and one that was not."""
    made = DemonstrationDataset(tmp_path / "data", task="can", keep_failures=True)
    for seed in range(4):
        made.add(make_episode(seed))
    made.add(make_episode(8, success=False))
    made.keep_failures = False
    made.add(make_episode(9, success=False))
    made.note_source("planner", Provenance(policy="p", task_definition="t"))
    return made


@pytest.fixture
def pictured(dataset: DemonstrationDataset) -> DemonstrationDataset:
    ObservationFolder(dataset.path / "observations", SETTINGS)
    for episode in dataset:
        draw(dataset, episode)
    return dataset


def draw(dataset: DemonstrationDataset, episode: Episode) -> None:
    pictures = {name: np.zeros((len(episode), *shape), kind) for name, (shape, kind) in SETTINGS.layout.items()}
    ObservationFolder(dataset.path / "observations").write(episode, pictures, ["can"])


def problems(dataset: DemonstrationDataset) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for findings in verify(dataset):
        for finding in findings:
            found.setdefault(finding.path.name, []).append(finding.problem)
    return found


def flip(path: Path, rng: np.random.Generator) -> Path:
    data = bytearray(path.read_bytes())
    data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    path.write_bytes(data)
    return path


def cut(path: Path, rng: np.random.Generator) -> Path:
    path.write_bytes(path.read_bytes()[: rng.integers(path.stat().st_size)])
    return path


def lose(path: Path, rng: np.random.Generator) -> Path:
    path.unlink()
    return path


def duplicate(path: Path, rng: np.random.Generator) -> Path:
    other = path.with_name(f"{rng.integers(16**12):016x}-planner.h5")
    shutil.copy(path, other)
    return other


def replace_by_another(path: Path, rng: np.random.Generator) -> Path:
    write_episode(path, make_episode(int(rng.integers(100, 10**6)), task=str(rng.choice(["can", "peach"]))))
    return path


def replace_by_one_of_another_policy(path: Path, rng: np.random.Generator) -> Path:
    """Of the same condition and outcome, as another dataset of the task holds it."""
    episode = next(e for e in map(make_episode, (*range(4), 8)) if e.id == path.stem)
    write_episode(path, replace(episode, meta=dict(episode.meta) | {"policy_hash": f"q{rng.integers(10**6)}"}))
    return path


def put_something_else(path: Path, rng: np.random.Generator) -> Path:
    other = path.with_name(f"notes-{rng.integers(10**6)}.txt")
    other.write_text("not an episode")
    return other


CORRUPTIONS = (flip, cut, lose, duplicate, replace_by_another, replace_by_one_of_another_policy, put_something_else)


def corrupt_and_find(dataset: DemonstrationDataset, trials: int) -> None:
    rng = np.random.default_rng(0)
    assert not problems(dataset)
    folders = (dataset.path / "episodes", dataset.path / "observations")
    whole = {path: path.read_bytes() for folder in folders for path in folder.glob("*.h5")}
    recordings = [path for path in whole if path.parent == folders[0]]
    for trial in range(trials):
        corrupt: Callable[[Path, np.random.Generator], Path] = CORRUPTIONS[trial % len(CORRUPTIONS)]
        among = recordings if corrupt is lose else list(whole)  # pictures can be rendered again: they may be missing
        harmed = corrupt(among[int(rng.integers(len(among)))], rng)
        assert harmed.name in problems(dataset), (trial, corrupt.__name__)
        if harmed not in whole:
            harmed.unlink()
        for path, content in whole.items():
            if not path.exists() or path.read_bytes() != content:
                path.write_bytes(content)
    assert not problems(dataset)


def test_every_corruption_of_a_file_is_found(pictured: DemonstrationDataset) -> None:
    corrupt_and_find(pictured, 120)


@pytest.mark.slow
def test_a_thousand_corruptions_are_found(pictured: DemonstrationDataset) -> None:
    corrupt_and_find(pictured, 1000)


def test_every_flipped_bit_of_the_ledger_is_found(dataset: DemonstrationDataset) -> None:
    rng, ledger = np.random.default_rng(1), dataset.ledger.path
    whole = ledger.read_bytes()
    for _ in range(60):
        flip(ledger, rng)
        assert problems(dataset)
        ledger.write_bytes(whole)


def test_what_a_ledger_lacks_is_found_by_the_recordings(dataset: DemonstrationDataset) -> None:
    whole = dataset.ledger.path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for left in ([], lines[:2], lines[1:]):
        dataset.ledger.path.write_bytes(b"".join(left))
        lost = [problem for problem in problems(dataset)["ledger.jsonl"] if problem.startswith("there is no line for")]
        assert len(lost) == len([line for line in lines if line not in left and b'"recorded": true' in line])
    dataset.ledger.path.unlink()
    assert len(problems(dataset)["ledger.jsonl"]) == 5


def test_every_flipped_bit_of_the_notes_beside_the_files_is_found(pictured: DemonstrationDataset) -> None:
    """What made the episodes, and what they were rendered with."""
    rng = np.random.default_rng(2)
    for name in ("generators.json", "observations/settings.json"):
        path = pictured.path / name
        whole = path.read_bytes()
        for _ in range(40):
            flip(path, rng)
            assert problems(pictured), path.read_bytes()
        path.write_bytes(b"{")
        assert path.name in problems(pictured)
        path.unlink()
        assert path.name in problems(pictured)
        path.write_bytes(whole)
    assert not problems(pictured)


def test_pictures_of_another_recording_are_reported(pictured: DemonstrationDataset) -> None:
    other = make_episode(0)
    steps = dict(other.steps) | {"q": other.steps["q"] + 1e-9}
    draw(pictured, replace(other, steps=steps))
    assert problems(pictured) == {f"{other.id}.h5": ["it was rendered from another recording"]}


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"q": np.full((20, 7), np.nan)}, "q is not finite at step 0"),
        ({"reward": np.r_[np.zeros(19), 0.5]}, "its last reward is 0.5, its success True"),
        ({"reward": np.r_[0.25, np.zeros(18), 1.0]}, "it has a reward before its last step"),
    ],
)
def test_what_was_recorded_wrongly_is_named(
    dataset: DemonstrationDataset, change: dict[str, np.ndarray], problem: str
) -> None:
    episode = make_episode(0)
    write_episode(dataset.file_of(episode.id), replace(episode, steps=dict(episode.steps) | change))
    assert problems(dataset) == {f"{episode.id}.h5": [problem]}


def test_states_that_differ_from_their_digests_are_named(dataset: DemonstrationDataset) -> None:
    episode = make_episode(0)
    digests = state_digests(episode.steps)
    assert len(digests) == 1, "one a second, and the recording is shorter than that"
    steps = dict(episode.steps) | {"q": episode.steps["q"] + 1e-12}
    write_episode(
        dataset.file_of(episode.id), replace(episode, steps=steps, meta=dict(episode.meta) | {"state_digests": digests})
    )
    assert problems(dataset) == {f"{episode.id}.h5": ["its states differ from their digest at second 0"]}


def test_an_outcome_that_the_ledger_contradicts_is_named(dataset: DemonstrationDataset) -> None:
    episode: Episode = make_episode(0)
    lost = replace(episode.outcome, success=False, failure="slipped")
    write_episode(dataset.file_of(episode.id), replace(episode, outcome=lost))
    assert problems(dataset) == {
        f"{episode.id}.h5": [
            "the ledger notes success True, the file False",
            "the ledger notes failure '', the file 'slipped'",
        ]
    }


FACTS = [*make_episode().facts(), "loads"]
OPTIONAL = ("loads",)  # older dynaforges did not note them


def lacking(facts: dict[str, Any], name: str, *, keep: bool) -> dict[str, Any]:
    return {key: value for key, value in facts.items() if keep or key != name}


@pytest.mark.parametrize("in_file", [True, False], ids=["file has it", "file lacks it"])
@pytest.mark.parametrize("in_ledger", [True, False], ids=["ledger has it", "ledger lacks it"])
@pytest.mark.parametrize("name", FACTS)
def test_a_fact_that_the_ledger_or_the_file_lacks_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, in_ledger: bool, in_file: bool
) -> None:
    made, episode = DemonstrationDataset(tmp_path, task="can"), replace(make_episode(), loads=Loads(peak_force=31.5))
    made.note_source("planner", Provenance(policy="p", task_definition="t"))
    line, header = Attempt.of(episode, recorded=True).to_dict(), episode.header()
    with monkeypatch.context() as patched:
        patched.setattr(Attempt, "to_dict", lambda self: lacking(line, name, keep=in_ledger))
        patched.setattr(Episode, "header", lambda self: lacking(header, name, keep=in_file))
        made.record(Attempt.of(episode), episode)
    found = problems(made)
    if in_ledger == in_file and (in_file or name in OPTIONAL):
        assert found == {}
    elif name in OPTIONAL:
        (problem,) = found[f"{episode.id}.h5"]
        assert problem.startswith(f"the ledger notes {name} ")
        assert "None" in problem
    else:
        assert ("line 1 was torn or altered" in found.get("ledger.jsonl", [])) == (not in_ledger)
        assert (f"{episode.id}.h5" in found) == (not in_file)


def test_a_load_that_the_ledger_contradicts_is_named(tmp_path: Path) -> None:
    made, episode = DemonstrationDataset(tmp_path, task="can"), replace(make_episode(), loads=Loads(peak_force=31.5))
    made.note_source("planner", Provenance(policy="p", task_definition="t"))
    made.add(episode)
    write_episode(made.file_of(episode.id), replace(episode, loads=Loads(peak_force=30.0)))
    (problem,) = problems(made)[f"{episode.id}.h5"]
    assert "'peak_force': 31.5" in problem
    assert "'peak_force': 30.0" in problem


@pytest.fixture
def real(tmp_path: Path) -> DemonstrationDataset:
    """Three attempts of the planner only, recorded whatever their outcome."""
    env, made = ResidualEnv("can"), DemonstrationDataset(tmp_path / "real", task="can", keep_failures=True)
    for condition in islice(env.task.conditions.stream("val"), 3):
        made.add(PlannerOnly().attempt(env, condition))
    made.note_source(PlannerOnly.name, Provenance("", task_digest(env.task)))
    env.close()
    return made


def test_verify_ends_with_0_or_1(real: DemonstrationDataset, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(real.path), "--replay", "--audit"]) == 0
    printed = capsys.readouterr().out
    assert "3 episodes read and made again, 3 attempts in the ledger: no problems" in printed
    for attempt in real.attempts():
        loads = attempt.loads
        assert loads is not None
        line = f"  {attempt.id}: {loads.peak_force:5.1f} N, {loads.force:5.1f} N; exceeds"
        assert (line in printed) == attempt.success
    flip(real.file_of(real.ids()[0]), np.random.default_rng(3))
    assert main(["verify", str(real.path)]) == 1
    assert real.ids()[0] in capsys.readouterr().out
    assert main(["verify", str(real.path / "nowhere")]) == 2


def test_an_attempt_at_what_is_no_condition_of_the_task_is_named(real: DemonstrationDataset) -> None:
    attempt = real.attempts()[0]
    for change in ({"difficulty": 1e300}, {"values": {}}):
        lost = Outcome(success=False, checkpoint=0, failure="x")
        odd = replace(attempt, condition=replace(attempt.condition, **change), outcome=lost, recorded=False)
        real.record(odd)
        found = [f for findings in verify(real, task=get_task("can")) for f in findings]
        assert any(f.path == real.ledger.path and odd.id in f.problem for f in found), found
