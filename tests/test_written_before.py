"""What an earlier commit wrote is read today, and the attempts that it made are made again bit for bit.

tests/written_before/README.md says which commit, and with which commands.
"""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.evaluation import DgrReport
from dynaforge.tasks import TASK_NAMES, get_task
from dynaforge.tasks.digest import task_digest
from dynaforge.training import settings
from dynaforge.training.history import TrainingHistory
from written_before import arithmetic, trajectories

BEFORE = Path(__file__).parent / "written_before"
STORED = json.loads(trajectories.STORED.read_text())
POLICY = "ba91e4241fe7b58c"  # digest of forge/policy.safetensors
EPISODE = "d054c1b5a150445010597629967b087365e407185af9f2692a6969359c6b2662"  # content hash of the one recording
ACTION = (-0.0009052011, -0.0010042011, 0.0001573722, 0.0006176058, -0.0002232916)  # of that policy at `OBSERVATION`
OBSERVATION = np.linspace(-1, 1, 82).astype(np.float32)
FORGE = shlex.split("forge --task can --updates 4 --demos 1 --attempts 4 --budget 60m --workers 1 --out")
COMPARE = shlex.split(
    "compare --task can --algos ppo grpo frontier_grpo --train-seeds 2 --steps 400 --stream val --seeds 1 "
    "--attempts 16 --workers 1 --out"
)


@pytest.fixture
def small_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train with the hyperparameters that the stored runs were trained with."""
    monkeypatch.setattr(settings, "files", lambda package: BEFORE / package.rpartition(".")[2])


@pytest.fixture
def forge(tmp_path: Path) -> Path:
    return Path(shutil.copytree(BEFORE / "forge", tmp_path / "forge"))


@pytest.fixture
def compare(tmp_path: Path) -> Path:
    return Path(shutil.copytree(BEFORE / "compare", tmp_path / "compare"))


@pytest.fixture(scope="module")
def same_physics() -> None:
    """Skip what compares bits of physics where the libraries below this package give other bits."""
    skip_unless_alike(arithmetic.PHYSICS)


@pytest.fixture(scope="module")
def same_training() -> None:
    """Skip what compares bits of a training where the libraries below this package give other bits."""
    skip_unless_alike(arithmetic.TRAINING)


def skip_unless_alike(computations: tuple[Callable[[], bytes], ...]) -> None:
    here = arithmetic.fingerprints(computations)
    if others := [name for name, value in here.items() if value != STORED["arithmetic"][name]]:
        pytest.skip(
            f"the libraries themselves compute other bits here ({', '.join(others)}) than where the hashes were made "
            f"({STORED['platform']}, {STORED['packages']})"
        )


def contents(folder: Path) -> dict[Path, tuple[bytes, int]]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder): (path.read_bytes(), path.stat().st_mtime_ns) for path in files}


def rows(table: str) -> list[str]:
    """Return the rows of a table that is printed, without its borders, header and legend."""
    return [line for line in table.splitlines() if line.startswith("│")]


@pytest.mark.parametrize("name", TASK_NAMES)
def test_every_task_is_defined_as_it_was(name: str) -> None:
    """Datasets, forge folders and runs name the digest of their task's definition, and take no other."""
    assert task_digest(get_task(name)) == STORED["tasks"][name]["definition"]
    assert trajectories.shipped_policy(name).digest == STORED["tasks"][name]["policy"]


@pytest.mark.usefixtures("same_physics")
@pytest.mark.parametrize("generator", trajectories.GENERATORS)
@pytest.mark.parametrize("name", TASK_NAMES)
def test_every_task_moves_as_it_did(name: str, generator: str) -> None:
    stored = STORED["tasks"][name]
    assert trajectories.summary(trajectories.attempt(name, generator), stored["columns"]) == stored[generator]


def test_a_dataset_is_read(forge: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset = DemonstrationDataset(forge / "demos")
    (episode,) = dataset
    assert episode.content_hash() == EPISODE
    assert len(episode) == 109
    assert dataset.sources()["residual"].policy == episode.meta["policy_hash"] == POLICY
    attempts = dataset.attempts()
    assert [attempt.success for attempt in attempts].count(True) == 1
    assert len(attempts) == 8
    assert main(["info", str(forge / "demos")]) == 0
    assert "1 recordings of 8 attempts" in capsys.readouterr().out
    before = contents(forge)
    assert main(["verify", str(forge / "demos"), "--audit", "--workers", "1"]) == 0
    assert "no problems" in capsys.readouterr().out
    assert contents(forge) == before


@pytest.mark.usefixtures("same_physics")
def test_a_dataset_is_made_again(capsys: pytest.CaptureFixture[str]) -> None:
    checks = ["--replay", "--pictures", "--workers", "1"]
    assert main(["verify", str(BEFORE / "forge" / "demos"), *checks]) == 0
    assert "no problems" in capsys.readouterr().out


def test_a_dataset_is_added_to(forge: Path) -> None:
    dataset = DemonstrationDataset(forge / "demos", task="can")
    (episode,) = dataset
    dataset.note_source("residual", dataset.sources()["residual"])
    dataset.add(episode)
    assert len(dataset) == 1
    assert len(dataset.attempts()) == 8


def test_a_policy_file_is_read() -> None:
    policy = MlpPolicyFile.load(BEFORE / "forge" / "policy.safetensors", task="can")
    assert policy.digest == POLICY
    assert (policy.meta["algo"], policy.meta["updates"]) == ("frontier_grpo", 4)
    np.testing.assert_allclose(policy(OBSERVATION), ACTION, atol=1e-7)


def test_a_checkpoint_of_stable_baselines3_is_read() -> None:
    model = FrontierGRPO.load(BEFORE / "frontier_grpo.zip", device="cpu")
    assert model.num_timesteps == 503
    assert MlpPolicyFile.of(model, task="can").digest == POLICY
    np.testing.assert_allclose(model.predict(OBSERVATION, deterministic=True)[0], ACTION, atol=1e-7)


def test_a_measurement_is_read() -> None:
    for stored in json.loads((BEFORE / "val.json").read_text())["reports"]:
        report = DgrReport.from_dict(stored)
        assert json.loads(json.dumps(report.to_dict())) == stored
        assert report.n == 16


@pytest.mark.usefixtures("small_settings")
def test_a_comparison_is_reported_and_none_of_its_runs_made_again(
    compare: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(compare)
    table = rows((compare / "table.txt").read_text())
    assert len(table) == 4
    assert main([*COMPARE, str(compare)]) == 0
    printed = capsys.readouterr().out
    assert "7 runs, 7 finished" in printed
    assert rows(printed) == rows((compare / "table.txt").read_text()) == table
    after = contents(compare)
    assert all(after[path] == kept for path, kept in before.items() if path.name != "table.txt")
    assert set(after) - set(before) == {Path("report.html"), Path("can/runs.json")}


@pytest.mark.slow
@pytest.mark.usefixtures("small_settings", "same_physics")
def test_of_a_comparison_only_what_is_missing_is_made(compare: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = rows((compare / "table.txt").read_text())
    missing = compare / "can" / "planner_only" / "exam.json"
    made = json.loads(missing.read_text())["attempts"]
    missing.unlink()
    before = contents(compare / "can")
    assert main([*COMPARE, str(compare), "--report-only"]) == 0
    printed = capsys.readouterr().out
    assert "7 runs, 6 finished" in printed
    assert rows(printed) == table[1:]
    assert main([*COMPARE, str(compare)]) == 0
    assert rows(capsys.readouterr().out) == table
    assert json.loads(missing.read_text())["attempts"] == made
    assert contents(compare / "can").items() >= before.items()


@pytest.mark.usefixtures("small_settings")
def test_a_finished_forge_is_shown(forge: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (forge / "report.html").touch()  # left out of what is stored
    before = contents(forge)
    assert main([*FORGE, str(forge)]) == 0
    printed = capsys.readouterr().out
    assert f"{forge} holds this run: finished" in printed
    assert [row.split("│")[1:4] for row in rows(printed)] == [
        [" planner only  ", " 4 ", "    0.0% "],
        [" with residual ", " 4 ", "    0.0% "],
    ]
    assert "1 episodes, 12% of attempts succeeded" in printed
    assert contents(forge) == before


@pytest.mark.slow
@pytest.mark.usefixtures("small_settings", "same_training")
def test_a_forge_that_was_killed_goes_on_to_the_same_end(forge: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its checkpoint is of the third of four updates; what came later is removed but for the longer history."""
    whole = TrainingHistory.load(forge / "history.json")
    expected = json.loads((forge / "measured.json").read_text())["attempts"]
    for name in ("trained.json", "measured.json", "result.json", "policy.safetensors"):
        (forge / name).unlink()
    shutil.rmtree(forge / "demos")
    assert main([*FORGE, str(forge)]) == 0
    assert "resuming after 3 updates" in capsys.readouterr().out
    assert MlpPolicyFile.load(forge / "policy.safetensors", task="can").digest == POLICY
    history = TrainingHistory.load(forge / "history.json")
    for name in ("successes", "trials", "groups", "timesteps", "optimizer_steps", "transitions_used"):
        assert getattr(history, name) == getattr(whole, name), name
    measured = json.loads((forge / "measured.json").read_text())["attempts"]
    for attempt in (attempt for made in (*measured, *expected) for attempt in made):
        del attempt["wall_seconds"]
    assert measured == expected
    assert [episode.content_hash() for episode in DemonstrationDataset(forge / "demos")] == [EPISODE]
    assert (forge / "report.html").is_file()
