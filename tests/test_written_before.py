"""What an earlier commit wrote is read today.

tests/written_before/README.md says which commit, and with which commands.
"""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.evaluation import DgrReport
from dynaforge.training import settings

BEFORE = Path(__file__).parent / "written_before"
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


def contents(folder: Path) -> dict[Path, tuple[bytes, int]]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder): (path.read_bytes(), path.stat().st_mtime_ns) for path in files}


def rows(table: str) -> list[list[str]]:
    """Return the cells of a table that is printed, row by row, without the column that was added since."""
    (names,) = ([cell.strip() for cell in line.split("┃")[1:-1]] for line in table.splitlines() if line[:1] == "┃")
    cells = ([cell.strip() for cell in line.split("│")[1:-1]] for line in table.splitlines() if line[:1] == "│")
    return [[cell for name, cell in zip(names, row, strict=True) if name != "95 % by t"] for row in cells]


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
    assert main(["verify", str(forge / "demos"), "--audit", "--workers", "1"]) == 1
    assert "it was recorded with another definition of task 'can'" in capsys.readouterr().out
    assert contents(forge) == before


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
    assert main([*COMPARE, str(compare)]) == 2
    assert "holds a run made under older physics, now reflex contact" in capsys.readouterr().err
    assert contents(compare) == before
    assert main([*COMPARE, str(compare), "--report-only"]) == 0
    printed = capsys.readouterr().out
    assert "7 runs, 7 finished" in printed
    assert "Made under older physics." in printed
    assert rows(printed) == rows((compare / "table.txt").read_text()) == table
    after = contents(compare)
    assert all(after[path] == kept for path, kept in before.items() if path.name != "table.txt")
    assert set(after) - set(before) == {Path("report.html"), Path("can/runs.json")}


@pytest.mark.slow
@pytest.mark.usefixtures("small_settings")
def test_a_comparison_is_reported(compare: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = rows((compare / "table.txt").read_text())
    (compare / "can" / "planner_only" / "exam.json").unlink()
    assert main([*COMPARE, str(compare), "--report-only"]) == 0
    printed = capsys.readouterr().out
    assert "7 runs, 6 finished" in printed
    assert rows(printed) == table[1:]


@pytest.mark.usefixtures("small_settings")
def test_a_forge_of_an_earlier_definition_is_not_gone_on_with(forge: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(forge)
    assert main([*FORGE, str(forge)]) == 2
    message = capsys.readouterr().err
    assert "task_definition 14ead588cba3ffa3" in message
    assert "Choose another --out" in message
    assert contents(forge) == before
